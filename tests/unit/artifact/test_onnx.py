"""An exported graph, stepped by another runtime, gives what the predictor gives."""

import json

import numpy as np
import onnx
import onnxruntime
import pytest

from tests.support.made import TRUE
from tests.unit.model.test_step_function import (
    ALL,
    PLANT,
    ROBOTS,
    TOGETHER,
    commands,
    compiled,
    corrected,
    robot,
    robot_motion,
    stepped,
)
from trueup.artifact.onnx import SCHEMA, to_onnx
from trueup.model.features import FRICTION
from trueup.model.predictor import Blind, Identified, LinearMap, Nominal, Residual
from trueup.model.series import DECLARED, Scheme


def run(plant, content, start, issued):
    """Observations of a graph that is stepped, three lanes at once."""
    session = onnxruntime.InferenceSession(content)
    metadata = session.get_modelmeta().custom_metadata_map
    labels = [f"({j})" for j in plant.joints] if len(plant.joints) > 1 else [""]
    begins = dict(
        zip(
            (
                *(f"{what}{label}" for what in ("position", "velocity") for label in labels),
                *(f"command{label} within its limits" for label in labels),
            ),
            (*start, *plant.applied(issued[0])),
            strict=True,
        )
    )
    first = [
        sum(factor * begins[of] for of, factor in x["of"].items())
        for x in json.loads(metadata["state"])
    ]
    state, rows = np.tile(first, (3, 1)), []
    for u in issued:
        seen, state = session.run(None, {"state": state, "command": np.tile(u, (3, 1))})
        rows.append(seen[1])
    return np.array(rows)


@pytest.mark.parametrize("scheme", [DECLARED, Scheme(0.5, 2)], ids=["declared", "symmetric"])
@pytest.mark.parametrize(
    "names", [(), *((n,) for n in ALL), TOGETHER], ids=lambda n: "+".join(n) or "none"
)
def test_a_graph_is_the_compiled_rollout(names, scheme):
    model, start, issued = corrected(names, scheme), (0.3, -0.2), commands()
    stepped_by_graph = run(PLANT, to_onnx(model, "a" * 64), start, issued)
    assert np.abs(stepped_by_graph - compiled(model, start, issued)).max() < 1e-9


@pytest.mark.parametrize(
    ("at", "scheme"),
    [
        *((at, Scheme(0.5, 2)) for at in ROBOTS.values()),
        *((ROBOTS[name], DECLARED) for name in ("none", "everywhere")),
    ],
    ids=[*ROBOTS, "none, declared", "everywhere, declared"],
)
def test_a_robots_graph_is_the_compiled_rollout(at, scheme):
    model = robot(at, scheme)
    start, issued = robot_motion(model.plant)
    stepped_by_graph = run(model.plant, to_onnx(model, "a" * 64), start, issued)
    other = model.plant.observe(model.run(start, issued))
    assert np.ptp(other[:, 0]) > 0.1
    assert np.abs(stepped_by_graph - other).max() < 1e-9


@pytest.mark.parametrize(
    "model",
    [
        Nominal(PLANT),
        Identified(PLANT, TRUE),
        Residual(
            PLANT,
            LinearMap((*FRICTION, "sin(q)"), np.random.default_rng(0).normal(size=(6, 2)) * 1e-2),
        ),
        Blind(
            PLANT, LinearMap(("q", "v", "u"), np.array([[0.99, -0.05], [0.05, 0.97], [0.0, 0.04]]))
        ),
    ],
    ids=lambda m: m.kind,
)
def test_every_kind_of_predictor_has_a_graph(model):
    issued = commands()
    stepped_by_graph = run(PLANT, to_onnx(model, "a" * 64), (0.3, -0.2), issued)
    assert np.abs(stepped_by_graph - stepped(model, (0.3, -0.2), issued)).max() < 1e-9


def test_a_graph_says_what_it_is_and_is_the_same_bytes_each_time():
    model = corrected(TOGETHER, DECLARED)
    content = to_onnx(model, "a" * 64)
    assert content == to_onnx(model, "a" * 64)
    read = onnx.load_from_string(content)
    by_name = {p.key: p.value for p in read.metadata_props}
    assert (by_name["schema"], by_name["artifact"], by_name["plant"]) == (
        SCHEMA,
        "a" * 64,
        PLANT.name,
    )
    assert float(by_name["period_s"]) == PLANT.timestep_s
    assert [x["name"] for x in json.loads(by_name["observation"])] == [
        c.name for c in PLANT.layout.observations
    ]
    assert {n.domain for n in read.graph.node} == {""}
    used = {name for n in read.graph.node for name in n.input}
    assert all(t.name in used for t in read.graph.initializer)


def test_a_state_says_in_words_what_it_begins_as():
    at = (("sensor_delay", 2), ("actuator_lag", 0))
    read = onnx.load_from_string(to_onnx(robot(at, DECLARED), "a" * 64))
    states = json.loads({p.key: p.value for p in read.metadata_props}["state"])
    begins = {x["name"]: x["begins"] for x in states}
    assert begins["velocity(s)"] == "velocity(s)"
    assert begins["actuator_lag.y(a)"] == "command(a) within its limits"
    assert begins["position 2 before(b)"] == "position(b) - 0.004 velocity(b)"
