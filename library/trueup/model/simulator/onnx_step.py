"""A simulator given as an ONNX model, run by onnxruntime.

Inputs are `state` `(n, states)`, `command` `(n, 1)`, and each parameter by its name, `(n,)` or
`(n, 1)`; it may also take `force` `(n, 1)` and `h_s` `(n,)`. The output named `next_state`, or the
first, is the state after a step. Numbers are float32 or float64.
"""

from __future__ import annotations

import importlib
import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadSimulator, NotInstalled

Array = NDArray[np.float64]
FIXED = "state", "command"
OPTIONAL = "force", "h_s"
KINDS = {"tensor(double)": np.float64, "tensor(float)": np.float32}


@dataclass(frozen=True, slots=True, eq=False)
class OnnxStep:
    """The step function of an ONNX model; `inputs` are its inputs' kinds of numbers and ranks."""

    session: Any
    inputs: dict[str, tuple[Any, int]]
    output: str

    @staticmethod
    def read(path: Path) -> OnnxStep:
        """The step function in a file. Raises BadSimulator, NotInstalled without onnxruntime."""
        try:
            runtime = importlib.import_module("onnxruntime")  # optional, and slow to load
        except ImportError as error:
            raise NotInstalled(
                "a simulator given as ONNX needs the package onnxruntime",
                hint="Install it with `pip install 'trueup[simulator]'`.",
            ) from error
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            session = runtime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:
            raise BadSimulator(f"{path.name} is no ONNX model: {error}") from error
        inputs = {}
        for one in session.get_inputs():
            if one.type not in KINDS:
                raise BadSimulator(f"{path.name}: the input {one.name} is a {one.type}")
            inputs[one.name] = KINDS[one.type], len(one.shape)
        missing = [name for name in FIXED if name not in inputs]
        if missing:
            raise BadSimulator(
                f"{path.name} has no input {missing[0]}; it has {', '.join(inputs)}",
                hint="Name the inputs state and command, and each parameter by its own name.",
            )
        outputs = [one.name for one in session.get_outputs()]
        return OnnxStep(session, inputs, "next_state" if "next_state" in outputs else outputs[0])

    @property
    def __signature__(self) -> inspect.Signature:
        """What it takes, as that of a function."""
        named = (*FIXED, "parameters", *(name for name in OPTIONAL if name in self.inputs))
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        return inspect.Signature([inspect.Parameter(name, kind) for name in named])

    def __call__(
        self, state: Array, command: Array, parameters: dict[str, Array], **more: Array
    ) -> Array:
        """States `(lanes, states)` after a step."""
        given = {"state": state, "command": command, **parameters, **more}
        unknown = [name for name in self.inputs if name not in given]
        if unknown:
            raise BadSimulator(
                f"the model has an input {unknown[0]}, which is no parameter",
                hint="Declare each of its parameters with its nominal value.",
            )
        fed = {
            name: _shaped(np.asarray(given[name], kind), rank)
            for name, (kind, rank) in self.inputs.items()
        }
        return np.asarray(self.session.run([self.output], fed)[0], np.float64)


def _shaped(values: NDArray[Any], rank: int) -> NDArray[Any]:
    return values[:, None] if values.ndim < rank else np.ascontiguousarray(values)
