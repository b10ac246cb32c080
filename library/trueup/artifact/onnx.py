"""ONNX: a predictor as a graph that any runtime can step. It is recorded by running the predictor's
step on symbols.

    inputs   state (n, states), command (n, commands)
    outputs  observation (n, observations) at the sample of the state,
             next_state (n, states) one declared period later

The numbers are float64, and the operations those of the step itself, in its order. The model's
metadata says what the columns are, their units, the period, and what each entry of a state begins
as. Source of the format: ONNX 1.12 (IR 8, operator set 17), which runtimes since 2022 read.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from types import ModuleType

import numpy as np

from trueup.artifact.onnx_graph import Graph
from trueup.canonical import Json
from trueup.errors import NotInstalled
from trueup.model.predictor import Predictor
from trueup.model.step_function import POSITION, VELOCITY, StepFunction

IR_VERSION, OPERATOR_SET = 8, 17
SCHEMA = "trueup.onnx/1"


def to_onnx(
    predictor: Predictor, artifact: str, diagnosis: Mapping[str, Json] | None = None
) -> bytes:
    """A predictor's step as an ONNX model; its metadata names the artifact by the digest
    `artifact`, and holds what a `diagnosis` says of it. Raises NotExportable of a simulator,
    NotInstalled without the package onnx."""
    onnx = _package()
    step_function = StepFunction.of(predictor)
    graph, names = Graph(onnx), step_function.names
    state = {name: graph.column("state", i) for i, name in enumerate(names)}
    commands = [graph.column("command", i) for i in range(len(step_function.plant.layout.commands))]
    seen, after = step_function.step(state, commands)
    like = state[names[0]]
    graph.output(seen, like, "observation")
    graph.output([after[name] for name in names], like, "next_state")
    ends = {
        "state": len(names),
        "command": len(commands),
        "observation": len(seen),
        "next_state": len(names),
    }
    values = {
        name: onnx.helper.make_tensor_value_info(name, onnx.TensorProto.DOUBLE, ["n", size])
        for name, size in ends.items()
    }
    nodes, initializers = graph.needed(("observation", "next_state"))
    made = onnx.helper.make_graph(
        nodes,
        predictor.plant.name,
        [values["state"], values["command"]],
        [values["observation"], values["next_state"]],
        initializers,
    )
    model = onnx.helper.make_model(
        made,
        ir_version=IR_VERSION,
        opset_imports=[onnx.helper.make_opsetid("", OPERATOR_SET)],
        producer_name="trueup",
    )
    onnx.helper.set_model_props(model, _metadata(step_function, artifact, diagnosis))
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


def _metadata(
    step_function: StepFunction, artifact: str, diagnosis: Mapping[str, Json] | None
) -> dict[str, str]:
    """The metadata of the columns."""
    plant, layout = step_function.plant, step_function.plant.layout
    metadata: dict[str, Json] = {
        "schema": SCHEMA,
        "plant": plant.name,
        "artifact": artifact,
        "period_s": plant.timestep_s,
        "state": [
            {"name": name, "begins": _sum_in_words(of), "of": dict(of)}
            for name, of in _beginnings(step_function).items()
        ],
        "command": [
            {
                "name": c.name,
                "unit": c.unit,
                "limits": list(c.limits or ()),
                "of": _within_limits(step_function.labels[plant.joint_of(c)]),
            }
            for c in layout.commands
        ],
        "observation": [{"name": c.name, "unit": c.unit} for c in layout.observations],
        **({"diagnosis": dict(diagnosis)} if diagnosis else {}),
    }
    return {
        name: value if isinstance(value, str) else json.dumps(value)
        for name, value in metadata.items()
    }


def _beginnings(step_function: StepFunction) -> dict[str, dict[str, float]]:
    """What each entry of a state begins as: the factors of positions, velocities and commands
    within their limits, in which it is linear."""
    labels = step_function.labels
    names = [
        *(f"{POSITION}{label}" for label in labels),
        *(f"{VELOCITY}{label}" for label in labels),
        *map(_within_limits, labels),
    ]
    begun = step_function.begin_held(*map(list, np.split(np.eye(len(names)), 3)))
    return {
        name: {of: float(x) for of, x in zip(names, factors, strict=True) if x}
        for name, factors in begun.items()
    }


def _within_limits(label: str) -> str:
    """What a joint's first command within its limits is called."""
    return f"command{label} within its limits"


def _sum_in_words(factors: Mapping[str, float]) -> str:
    terms = [name if x == 1.0 else f"{x!r} {name}" for name, x in factors.items()]
    return " + ".join(terms).replace("+ -", "- ") or "0"
