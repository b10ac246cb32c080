"""A mass on a link, told from the numbers that it moves."""

import math

import mujoco
import pytest

from tests.support.robots import arm_plant, recorded
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.explore import unexplored
from trueup.diagnose.payload import payload
from trueup.diagnose.problem_setup import Recordings
from trueup.diagnose.summary_text import sentence

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

ROLES = ["adaptation"] * 3 + ["validation"]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return arm_plant(tmp_path_factory.mktemp("arm"))


def carrying(body, mass, at):
    def change(spec):
        spec.body(body).add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], pos=at, mass=mass
        )

    return change


def found(plant, change):
    episodes = recorded(plant, change, range(4), ROLES, seconds=4.0)
    recordings = Recordings.of(plant, episodes)
    search = unexplored(recordings, assess(plant, recordings.adaptation))
    directions = search.problem.fitter.directions
    return payload(plant, directions, search.base, recordings.adaptation)


@pytest.mark.parametrize(
    ("body", "joint", "mass", "at"),
    [("lower", "elbow", 0.5, [0.25, 0.0, 0.0]), ("upper", "shoulder", 0.8, [0.15, 0.0, 0.0])],
)
def test_a_mass_is_found_on_its_link(arm, body, joint, mass, at):
    carried = found(arm, carrying(body, mass, at))
    assert carried.links == (joint,)
    assert carried.mass_kg == pytest.approx(mass, rel=0.015)
    x, y, along = carried.centre_m
    assert math.hypot(x, y) == pytest.approx(at[0], rel=0.02)
    assert along is None, "all axes are parallel: nothing shows where along them it is"
    for axis, coordinate in zip(carried.axes, (x, y), strict=False):
        assert coordinate == pytest.approx(
            sum(a * b for a, b in zip(axis, at, strict=True)), abs=0.005
        )


def test_a_mass_where_two_links_meet_is_told_of_both(arm):
    assert set(found(arm, carrying("upper", 0.8, [0.3, 0.0, 0.0])).links) == {"shoulder", "elbow"}


def heavier_and_lighter(spec):
    spec.body("upper").first_geom().mass *= 1.2
    spec.body("lower").first_geom().mass *= 0.85


@pytest.mark.parametrize("change", [lambda _: None, heavier_and_lighter])
def test_other_numbers_are_no_payload(arm, change):
    assert found(arm, change) is None


def test_a_report_names_the_mass_and_its_link(arm):
    episodes = recorded(arm, carrying("lower", 0.5, [0.25, 0, 0]), range(4), ROLES, seconds=4.0)
    document = diagnose(arm, episodes).document
    assert document["verdict"] == "parameters_only"
    assert document["payload"]["links"] == ["elbow"]
    low, high = document["payload"]["mass"]["ci95"]
    assert low < 0.5 < high
    assert "kg more on the link of elbow, 0.25 m from the axis of its joint" in sentence(document)
