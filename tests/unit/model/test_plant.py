"""plant.json: what is read, and what is refused at which field."""

import copy

import numpy as np
import pytest

from tests.support.made import plant_document
from trueup.chapter.data import DEPLOYMENT, SHIFTED
from trueup.errors import BadPlant
from trueup.model.plant import Plant


def changed(path: str, value: object) -> dict:
    document = copy.deepcopy(plant_document())
    *parents, last = path.split("/")
    at = document
    for key in parents:
        at = at[int(key)] if isinstance(at, list) else at[key]
    if value is KeyError:
        del at[last]
    else:
        at[int(last) if isinstance(at, list) else last] = value
    return document


def test_a_plant_is_read():
    plant = Plant.from_document(plant_document())
    assert (plant.name, plant.family, plant.parameters, plant.timestep_s, plant.horizon_s) == (
        "bench-joint",
        "oscillator",
        (1.0, 0.4, 1.0),
        0.05,
        2.0,
    )
    assert plant.envelope == {"q": (-0.9, 0.9), "v": (-3.0, 3.0)}
    assert plant.limits[0].tolist() == [-1.0]
    assert plant.state_columns.tolist() == [0, 1]


def test_the_same_description_has_the_same_digest_whatever_its_order():
    backwards = dict(reversed(plant_document().items()))
    assert Plant.from_document(backwards).digest == Plant.from_document(plant_document()).digest


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ("name", "../etc/passwd", "name"),
        ("name", "", "name"),
        ("name", "Upper", "name"),
        ("name", KeyError, "name"),
        ("nominal/family", "spring", "nominal.family"),
        ("nominal/timestep_s", 0, "nominal.timestep_s"),
        ("nominal/timestep_s", "fast", "nominal.timestep_s"),
        ("nominal/timestep_s", True, "nominal.timestep_s"),
        ("nominal/integrator", "rk4", "nominal.integrator"),
        ("nominal/parameters/k", KeyError, "nominal.parameters.k"),
        ("nominal/parameters/k", float("nan"), "nominal.parameters.k"),
        ("nominal/parameters/mass", 1.0, "nominal.parameters.mass"),
        ("nominal/mjcf", "arm.xml", "nominal.tree"),
        ("commands", [], "commands"),
        ("commands/0/limits", [1.0, -1.0], "commands[0].limits.upper"),
        ("commands/0/limits", [1.0], "commands[0].limits"),
        ("commands/0/limits", KeyError, "commands[0].limits"),
        ("observations/0/scale", 0.0, "observations[0].scale"),
        ("observations/0/field", "torque", "observations[0].field"),
        ("observations/1/name", "q", "observations"),
        ("observations/1/joint", "elbow", "observations"),
        ("observations/0/field", "effort", "observations"),
        ("envelope/q", [1, 0], "envelope.q.upper"),
        ("evaluation/horizon_s", 0.01, "evaluation.horizon_s"),
        ("topics/state", "/x", "topics.state"),
        ("colour", "red", "colour"),
    ],
)
def test_a_wrong_field_is_named(path, value, field):
    with pytest.raises(BadPlant) as refused:
        Plant.from_document(changed(path, value))
    assert refused.value.facts["field"] == field


@pytest.mark.parametrize("document", [None, [], "plant", 3])
def test_what_is_no_object_is_refused(document):
    with pytest.raises(BadPlant):
        Plant.from_document(document)


@pytest.mark.parametrize(
    ("parameters", "stable"),
    [
        ((1.0, 0.4, 1.0), True),
        (DEPLOYMENT, True),
        (SHIFTED, True),
        ((1.0, -0.1, 1.0), False),
        ((2000.0, 0.4, 1.0), False),
        ((-1.0, 0.4, 1.0), False),
    ],
)
def test_stability_is_that_of_the_eigenvalues(parameters, stable):
    plant = Plant.from_document(plant_document())
    k, c, dt = parameters[0], parameters[1], plant.timestep_s
    by_hand = np.array([[1 - dt * dt * k, dt * (1 - dt * c)], [-dt * k, 1 - dt * c]])
    assert plant.is_stable(parameters) is stable
    assert bool(np.abs(np.linalg.eigvals(by_hand)).max() < 1) is stable


def test_the_applied_command_is_the_issued_one_within_its_limits():
    assert Plant.from_document(plant_document()).applied(
        np.array([[-3.0], [0.5], [7.0]])
    ).tolist() == [[-1.0], [0.5], [1.0]]
