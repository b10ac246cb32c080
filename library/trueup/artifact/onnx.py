"""ONNX: a predictor of one joint as a graph that any runtime can step. It is recorded by running
the predictor's step on symbols.

    inputs   state (n, states), command (n, 1)
    outputs  observation (n, observations) at the sample of the state,
             next_state (n, states) one declared period later

The numbers are float64, and the operations those of the step itself, in its order. The model's
metadata says what the columns are, their units, the period, and how a state begins. Source of the
format: ONNX 1.12 (IR 8, operator set 17), which runtimes since 2022 read.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from trueup.canonical import Json
from trueup.errors import NotExportable, NotInstalled
from trueup.model.predictor import Predictor
from trueup.model.step_function import StepFunction

IR_VERSION, OPERATOR_SET = 8, 17
SCHEMA = "trueup.onnx/1"
OPERATORS: Mapping[str, str] = {
    "add": "Add", "subtract": "Sub", "multiply": "Mul", "divide": "Div", "negative": "Neg",
    "absolute": "Abs", "sign": "Sign",
    "minimum": "Min", "maximum": "Max", "sin": "Sin", "exp": "Exp", "rint": "Round",
    "greater": "Greater", "less": "Less", "greater_equal": "GreaterOrEqual",
    "less_equal": "LessOrEqual", "equal": "Equal",
}  # fmt: skip
COMPARISONS = ("Greater", "Less", "GreaterOrEqual", "LessOrEqual", "Equal")


def to_onnx(predictor: Predictor, artifact: str) -> bytes:
    """A predictor's step as an ONNX model; its metadata names the artifact by the digest
    `artifact`. Raises NotExportable for a robot given as MJCF, NotInstalled without the package
    onnx."""
    onnx = _package()
    stepper = StepFunction.of(predictor)
    graph = Graph(onnx)
    names = stepper.names
    state = {name: graph.column("state", i) for i, name in enumerate(names)}
    seen, after = stepper.step(state, graph.column("command", 0))
    graph.stack([graph.whole(x, state) for x in seen], "observation")
    graph.stack([graph.whole(after[name], state) for name in names], "next_state")
    ends = {"state": len(names), "command": 1, "observation": len(seen), "next_state": len(names)}
    values = {
        name: onnx.helper.make_tensor_value_info(name, onnx.TensorProto.DOUBLE, ["n", size])
        for name, size in ends.items()
    }
    made = onnx.helper.make_graph(
        graph.needed(("observation", "next_state")),
        predictor.plant.name,
        [values["state"], values["command"]],
        [values["observation"], values["next_state"]],
        graph.initializers(),
    )
    model = onnx.helper.make_model(
        made,
        ir_version=IR_VERSION,
        opset_imports=[onnx.helper.make_opsetid("", OPERATOR_SET)],
        producer_name="trueup",
    )
    onnx.helper.set_model_props(model, _metadata(stepper, artifact))
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def _package() -> ModuleType:
    try:
        return importlib.import_module("onnx")  # optional, and slow to load
    except ImportError as error:
        raise NotInstalled(
            "writing ONNX needs the package onnx",
            hint="Install it with `pip install 'trueup[onnx]'`.",
        ) from error


def _metadata(stepper: StepFunction, artifact: str) -> dict[str, str]:
    """The metadata of the columns. A state begins with the position, the velocity and the first
    command (limited), or at 0."""
    layout, (low, high) = stepper.plant.layout, (float(bound[0]) for bound in stepper.plant.limits)
    u = high if high != 0.0 else low
    q, v = 1e3 * abs(u) + 1.0, 1e3 * abs(u) + 2.0  # three numbers that are not one another, nor 0
    marks = {q: "position", v: "velocity", u: "command within its limits", 0.0: "0"}
    metadata: dict[str, Json] = {
        "schema": SCHEMA,
        "plant": stepper.plant.name,
        "artifact": artifact,
        "period_s": stepper.plant.timestep_s,
        "state": [{"name": name, "begins": marks[x]} for name, x in stepper.begin(q, v, u).items()],
        "command": [
            {"name": c.name, "unit": c.unit, "limits": list(c.limits or ())}
            for c in layout.commands
        ],
        "observation": [{"name": c.name, "unit": c.unit} for c in layout.observations],
    }
    return {
        name: value if isinstance(value, str) else json.dumps(value)
        for name, value in metadata.items()
    }


class Graph:
    """Nodes in the order in which they were recorded, and constants by value."""

    def __init__(self, onnx: ModuleType) -> None:
        self._onnx, self._nodes, self._constants = onnx, list[Any](), dict[str, Any]()

    def column(self, source: str, number: int) -> Symbol:
        """A column `(n,)` of an input."""
        return self.apply(
            "Gather", [Symbol(self, source), self._constant(np.int64(number))], axis=1
        )

    def whole(self, x: Any, state: Mapping[str, Symbol]) -> Symbol:
        """A result as a column, where it is one number for all rows."""
        return x if isinstance(x, Symbol) else next(iter(state.values())) * 0.0 + x

    def stack(self, columns: list[Symbol], name: str) -> None:
        """Columns beside each other, as an output."""
        wide = [
            self.apply("Unsqueeze", [x, self._constant(np.array([1], np.int64))]) for x in columns
        ]
        self._nodes.append(
            self._onnx.helper.make_node("Concat", [x.name for x in wide], [name], axis=1)
        )

    def apply(self, operator: str, inputs: list[Any], **attributes: Any) -> Symbol:
        """The result of an operator on symbols and numbers."""
        operands = [x if isinstance(x, Symbol) else self._constant(np.float64(x)) for x in inputs]
        if operator != "Cast" and not (operator == "Equal" and all(x.is_truth for x in operands)):
            operands = [
                self.apply("Cast", [x], to=self._onnx.TensorProto.DOUBLE) if x.is_truth else x
                for x in operands
            ]
        name = f"x{len(self._nodes)}"
        self._nodes.append(
            self._onnx.helper.make_node(operator, [x.name for x in operands], [name], **attributes)
        )
        return Symbol(self, name, is_truth=operator in COMPARISONS)

    def _constant(self, value: np.ndarray | np.generic) -> Symbol:
        name = f"c_{np.asarray(value).dtype}_{np.asarray(value).tolist()}"
        self._constants[name] = self._onnx.numpy_helper.from_array(np.asarray(value), name)
        return Symbol(self, name)

    def needed(self, outputs: tuple[str, ...]) -> list[Any]:
        """The nodes that outputs depend on; constants that no node needs are removed."""
        wanted, nodes = set(outputs), []
        for node in reversed(self._nodes):
            if wanted.intersection(node.output):
                wanted.update(node.input)
                nodes.append(node)
        self._constants = {name: x for name, x in self._constants.items() if name in wanted}
        return nodes[::-1]

    def initializers(self) -> list[Any]:
        """The constants as ONNX initializers."""
        return list(self._constants.values())


class Symbol(NDArrayOperatorsMixin):
    """A value that the graph will have. numpy functions on it are recorded as nodes."""

    def __init__(self, graph: Graph, name: str, *, is_truth: bool = False) -> None:
        self.graph, self.name, self.is_truth = graph, name, is_truth

    def __bool__(self) -> bool:
        raise NotExportable("an effect decides by a value in a way that no graph can hold")

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **more: Any) -> Symbol:
        if (
            method != "__call__"
            or more
            or (function is not np.copysign and function.__name__ not in OPERATORS)
        ):
            raise NotExportable(
                f"an effect uses {function.__name__}, which is not written down here"
            )
        if (
            function is np.copysign
        ):  # of what is not negative, where a zero's own sign does not matter
            size, sign = inputs
            return self.graph.apply("Mul", [size, np.sign(sign)])
        return self.graph.apply(OPERATORS[function.__name__], list(inputs))
