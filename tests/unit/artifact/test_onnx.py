"""An exported graph, stepped by another runtime, gives what the predictor gives."""

import json

import numpy as np
import onnx
import onnxruntime
import pytest

from tests.support.made import TRUE
from tests.support.robots import arm_plant
from tests.unit.model.test_step_function import (
    ALL,
    PLANT,
    TOGETHER,
    commands,
    compiled,
    corrected,
    stepped,
)
from trueup.artifact.onnx import SCHEMA, to_onnx
from trueup.errors import NotExportable
from trueup.model.features import FRICTION
from trueup.model.predictor import Blind, Identified, LinearMap, Nominal, Residual
from trueup.model.series import DECLARED, Scheme


def run(content, start, issued):
    """Observations of a graph that is stepped, three lanes at once."""
    session = onnxruntime.InferenceSession(content)
    result = session.get_modelmeta().custom_metadata_map
    begins = {
        "position": start[0],
        "velocity": start[1],
        "command within its limits": float(np.clip(issued[0, 0], *PLANT.limits).item()),
        "0": 0.0,
    }
    state = np.tile([begins[x["begins"]] for x in json.loads(result["state"])], (3, 1))
    rows = []
    for u in issued[:, 0]:
        seen, state = session.run(None, {"state": state, "command": np.full((3, 1), u)})
        rows.append(seen[1])
    return np.array(rows)


@pytest.mark.parametrize("scheme", [DECLARED, Scheme(0.5, 2)], ids=["declared", "symmetric"])
@pytest.mark.parametrize(
    "names", [(), *((n,) for n in ALL), TOGETHER], ids=lambda n: "+".join(n) or "none"
)
def test_a_graph_is_the_compiled_rollout(names, scheme):
    model, start, issued = corrected(names, scheme), (0.3, -0.2), commands()
    assert (
        np.abs(run(to_onnx(model, "a" * 64), start, issued) - compiled(model, start, issued)).max()
        < 1e-9
    )


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
    assert (
        np.abs(
            run(to_onnx(model, "a" * 64), (0.3, -0.2), issued) - stepped(model, (0.3, -0.2), issued)
        ).max()
        < 1e-9
    )


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


def test_a_robot_of_several_joints_has_none(tmp_path):
    with pytest.raises(NotExportable, match="given as MJCF"):
        to_onnx(Nominal(arm_plant(tmp_path)), "a" * 64)
