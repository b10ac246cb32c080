"""A simulator of several joints: its rollout is the compiled one's of the same robot, effect by
effect and joint by joint."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support import windowed
from tests.support.own_arm import JOINTS, numbers, own_arm, step
from tests.support.robots import PERIOD_S, arm_document, arm_plant
from trueup.errors import BadPlant, BadSimulator
from trueup.model.block import term
from trueup.model.effect import Port, effects
from trueup.model.hypothesis import Hypothesis, Scales
from trueup.model.plant import Plant
from trueup.model.simulator.simulator import offer
from trueup.model.simulator.step import SimulatedStep

SAMPLES, SIZES = 201, Scales(1.0, 3.0, 30.0, 5.0)
OF_CHANGE = 0.02  # of what an effect changes
OF_PUSH = 2e-4  # a filter's push is foreseen in the simulator's own middle velocity
ONE_UNIT = np.array([0.26, 0.06])  # of an effect's force, in both


@pytest.fixture(scope="module")
def plants(tmp_path_factory):
    return own_arm(), arm_plant(tmp_path_factory.mktemp("arm"))


def series_of(begins=0):
    t = np.arange(SAMPLES) * PERIOD_S
    u = np.stack([4.0 + 3.0 * np.sin(9.0 * t), 1.0 + np.sign(np.sin(20.0 * t))], axis=1)
    noise = 0.01 * np.random.default_rng(1).normal(size=(SAMPLES, 4))
    return windowed.series_of(u, noise, PERIOD_S, [25.0, 25.0], begins, 70)


def rolled(plant, terms, s, gain=None):
    """Terms with their numbers, with starts and pasts moved a little in some lanes."""
    form = replace(plant.form, sizes=ONE_UNIT)
    return windowed.rolled(form, plant.parameters, Hypothesis(tuple(terms)), s, SIZES, gain)


def named(effect):
    """Terms of an effect at the second joint; what acts on a whole log acts at the first."""
    return [term(effect, 0 if effects()[effect].port is Port.TIMING else 1)]


def apart(effect, expected, without):
    """How far apart the two may be: the compiled rollout works forces out at one moment of a step,
    the other as means over it."""
    at_force = effects()[effect].port in (Port.FORCE, Port.FRICTION)
    return OF_CHANGE * np.abs(expected - without).max() if at_force else 1e-9


def test_the_nominal_robot_is_the_same(plants):
    given, expected = (rolled(plant, [], series_of()) for plant in plants)
    np.testing.assert_allclose(given, expected, atol=1e-9)
    # a step's damping adds to what a force has to move
    np.testing.assert_allclose(*(plant.form.sizes for plant in plants), rtol=1e-2)


@pytest.mark.parametrize("effect", list(effects()))
@pytest.mark.parametrize("begins", [0, 7])
def test_every_effect_acts_as_in_the_compiled_rollout(plants, effect, begins):
    s = series_of(begins)
    counted = s.window_of >= 0
    given, expected = (rolled(plant, named(effect), s)[counted] for plant in plants)
    without = rolled(plants[1], [], s)[counted]
    np.testing.assert_allclose(given, expected, atol=apart(effect, expected, without))


@pytest.mark.parametrize("effect", list(effects()))
def test_a_filter_runs_ahead_of_windows_as_in_the_compiled_rollout(plants, effect):
    gain = np.zeros((3, 2, 4, 2))
    gain[1:, :, [0, 1, 2, 3], [0, 1, 1, 1]] = 0.3, 0.3, 2.0, 0.2
    s = series_of()
    given, expected = (rolled(plant, named(effect), s, gain)[:, :, :2] for plant in plants)
    unfiltered = (rolled(plants[1], terms, s) for terms in (named(effect), []))
    about = max(OF_PUSH, apart(effect, *unfiltered))
    np.testing.assert_allclose(given, expected, atol=about)


def test_friction_at_both_joints_is_that_of_the_compiled_rollout(plants):
    both = [term("coulomb_friction", j) for j in range(2)]
    given, expected = (rolled(plant, both, series_of()) for plant in plants)
    without = rolled(plants[1], [], series_of())
    np.testing.assert_allclose(given, expected, atol=apart("coulomb_friction", expected, without))


def test_the_channels_name_the_joints():
    nominal = {"simulator": "arm", "sha256": offer(step), "timestep_s": PERIOD_S}
    with pytest.raises(BadPlant, match="names no joint of the model"):
        Plant.from_document(
            arm_document(
                nominal={**nominal, "parameters": numbers(), "joints": ["shoulder", "wrist"]}
            )
        )
    with pytest.raises(BadPlant, match="list of names"):
        Plant.from_document(
            arm_document(nominal={**nominal, "parameters": numbers(), "joints": ["a", "a"]})
        )
    with pytest.raises(BadSimulator, match="the step of arm"):
        Plant.from_document(
            arm_document(nominal={**nominal, "parameters": numbers(), "joints": [*JOINTS, "wrist"]})
        )


def test_a_lane_that_no_force_moves_spoils_no_other():
    one = SimulatedStep(None, {}, [], [], np.ones(2), 0.5, np.ones(2), PERIOD_S, frozenset())
    forces = one._as_forces(np.stack([np.eye(2), np.zeros((2, 2))]), np.ones((2, 2)))
    np.testing.assert_array_equal(forces, [[1.0, 1.0], [np.nan, np.nan]])
