"""What is said of an answer: units, intervals, bounds of what was not found."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.robots import arm_plant
from tests.support.simulated import recorded_twice as recorded
from trueup.diagnose.bounds import Bound, _bound
from trueup.diagnose.explain import counted, described, in_units, unit
from trueup.fit.screening import Screening
from trueup.model.effect import Scale, effects


@pytest.fixture(scope="module")
def joint():
    return recorded("A1", [], 1)[0]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return arm_plant(tmp_path_factory.mktemp("arm"))


def bound(effect, cost, factor, error, *, reduced_chi_square=1.0):
    """The bound of an effect whose guesses were screened so."""
    guesses = len(effects()[effect].starts)
    screening = Screening(*(np.broadcast_to(x, guesses) for x in (cost, factor, error, -1, 0.0)))
    search = SimpleNamespace(problem=SimpleNamespace(fitter=SimpleNamespace(unit=lambda *_: 2.0)))
    fit = SimpleNamespace(reduced_chi_square=reduced_chi_square)
    plant = SimpleNamespace(
        joints=(None,),
        names_joints=False,
        joint_name=lambda _: "joint",
        joint_of=lambda _: 0,
        dynamics=None,
        command_columns=np.array([0]),
        form=SimpleNamespace(sizes=np.ones(1)),
        layout=SimpleNamespace(observations=(), commands=(SimpleNamespace(unit="V"),)),
    )
    return _bound(search, screening, fit, effect, plant)


@pytest.mark.parametrize(
    ("scale", "expected"),
    [
        (Scale.ACCELERATION, "rad/s^2"),
        (Scale.VELOCITY, "rad/s"),
        (Scale.STIFFNESS, "1/s^2"),
        (Scale.DAMPING, "1/s"),
        (Scale.COMMAND, "rad/s^2"),
        (Scale.RATE, "rad/s^2/s"),
        (Scale.TIME, "s"),
        (Scale.ONE, "1"),
    ],
)
def test_a_familys_forces_are_accelerations(joint, scale, expected):
    assert unit(scale, joint) == expected
    assert in_units(scale, joint, 0) == 1.0


@pytest.mark.parametrize(
    ("scale", "expected"),
    [
        (Scale.ACCELERATION, "N·m"),
        (Scale.STIFFNESS, "N·m/rad"),
        (Scale.DAMPING, "N·m s/rad"),
        (Scale.POSITION, "rad"),
    ],
)
def test_a_robots_forces_are_what_its_actuators_give(arm, scale, expected):
    assert unit(scale, arm) == expected


def test_a_robots_forces_are_in_units_of_each_joints_inertia(arm):
    assert [in_units(Scale.DAMPING, arm, j) for j in range(len(arm.joints))] == list(arm.form.sizes)
    assert in_units(Scale.POSITION, arm, 0) == 1.0


def test_every_number_of_a_robot_has_a_unit_and_a_name(arm):
    table = described(arm)
    assert set(table) == set(arm.dynamics.parameter_names)
    first, second = arm.joints[:2]
    assert table[f"hx({first})"] == {"unit": "kg·m", "label": "first moment along x"}
    assert table[f"damping({second})"]["unit"] == "N·m s/rad"
    assert table[f"gain({first})"]["unit"] == "1"  # N·m commanded, N·m at the joint
    assert all(row["unit"] and row["label"] for row in table.values())


def test_what_the_data_leave_of_an_effect_is_the_expected_part_and_three_errors():
    """Of the smallest guess, in the fit's units: 2 x guess x (factor + 3 errors)."""
    least = min(abs(s[0]) for s in effects()["coulomb_friction"].starts)
    found = bound("coulomb_friction", 1.0, 0.05, 0.01)
    assert found.value == pytest.approx(2.0 * least * (0.05 + 3.0 * 0.01))
    wider = bound("coulomb_friction", 1.0, 0.05, 0.01, reduced_chi_square=4.0)
    assert wider.value == pytest.approx(2.0 * least * (0.05 + 3.0 * 0.02))


def test_a_bound_beyond_what_was_computed_is_none_and_says_what_would_show_it():
    found = bound("coulomb_friction", 1.0, 0.05, 1.0)
    assert found.value is None
    assert found.why
    assert found.document() == {"effect": "coulomb_friction", "why": found.why}


def test_a_limit_is_bounded_from_below_by_the_weakest_that_would_have_shown():
    starts = sorted(s[0] for s in effects()["saturation"].starts)
    found = bound("saturation", 1.0, 0.0, 0.1)
    assert (found.falls, found.value) == (True, pytest.approx(2.0 * starts[-1]))
    assert bound("saturation", 1.0, 1.0, 0.1).value is None
    assert "above" in found.document()


def test_a_bound_is_told_with_its_unit_and_confidence():
    told = Bound("backlash", "elbow", "gap", 0.01, False, "rad", "").document()
    assert told == {
        "effect": "backlash",
        "joint": "elbow",
        "parameter": "gap",
        "label": "gap",
        "below": 0.01,
        "unit": "rad",
        "confidence": 0.95,
    }


def test_repeated_frames_are_named_from_half_a_per_cent_on(joint):
    def quality(part):
        return SimpleNamespace(
            held=np.array([part]), lattices=lambda _: (np.zeros(2), np.zeros(2, np.bool_))
        )

    assert counted(quality(0.004), joint, 1000) == []
    ((entry),) = counted(quality(0.1), joint, 1000)
    half = 1.96 * np.sqrt(0.1 * 0.9 / 1000)
    assert entry["effect"] == "dropped_frames"
    assert entry["estimate"]["fraction"] == {
        "value": 0.1,
        "unit": "1",
        "ci95": [pytest.approx(0.1 - half), pytest.approx(0.1 + half)],
        "label": "fraction of frames",
    }


def test_a_coarse_quantizer_is_named_with_its_step_and_a_fine_one_is_not(joint):
    lattice, coarse = np.array([0.02, 0.001]), np.array([True, False])
    quality = SimpleNamespace(held=np.zeros(1), lattices=lambda _: (lattice, coarse))
    ((entry),) = counted(quality, joint, 1000)
    assert [(v["value"], v["unit"]) for v in entry["estimate"].values()] == [(0.02, "rad")]
    assert entry["parameters"] == list(entry["estimate"])
