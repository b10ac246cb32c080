"""A simulator of several joints: its rollout is the compiled one's of the same robot, effect by
effect and joint by joint."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.own_arm import JOINTS, numbers, own_arm, step
from tests.support.robots import PERIOD_S, arm_document, arm_plant
from trueup.errors import BadPlant, BadSimulator
from trueup.model.block import BLOCK, term
from trueup.model.effect import Port, effects
from trueup.model.hypothesis import Hypothesis, Scales, begun, switches
from trueup.model.plant import Plant
from trueup.model.roll import roll
from trueup.model.series import Scheme, Series, integral_of
from trueup.model.simulator.simulator import offer
from trueup.model.simulator.step import SimulatedStep

SAMPLES, SIZES = 201, Scales(1.0, 3.0, 30.0, 5.0)
OF_CHANGE = 0.02  # of what an effect changes
OF_PUSH = 2e-4  # a filter's push is foreseen in the simulator's own middle velocity
ONE_UNIT = np.array([0.26, 0.06])  # of an effect's force, in both


@pytest.fixture(scope="module")
def plants(tmp_path_factory):
    return own_arm(), arm_plant(tmp_path_factory.mktemp("arm"))


def series_of(begins=0, every=70):
    t = np.asarray(np.arange(SAMPLES) * PERIOD_S)
    t.flags.writeable = False
    u = np.stack([4.0 + 3.0 * np.sin(9.0 * t), 1.0 + np.sign(np.sin(20.0 * t))], axis=1)
    resets = np.full(SAMPLES, -1)
    resets[begins::every] = np.arange(len(resets[begins::every]))
    windows = int((resets >= 0).sum())
    steps = np.ones(SAMPLES, np.int64)
    steps[-1] = 0
    noise = 0.01 * np.random.default_rng(1).normal(size=(SAMPLES, 4))
    return Series(
        "series", Scheme(0.5, 1), t, np.full(SAMPLES, PERIOD_S), steps, u, np.zeros_like(u),
        integral_of(u, t), noise, np.ones((SAMPLES, 4), np.bool_), np.cumsum(resets >= 0) - 1,
        resets, np.zeros((windows, 4)), np.zeros((windows, 4)), PERIOD_S, np.array([25.0, 25.0]),
    )  # fmt: skip


def rolled(plant, terms, s, gain=None):
    """Terms with their numbers, with starts and pasts moved a little in some lanes."""
    values = plant.block.nulls.copy()
    values[: len(plant.parameters)] = plant.parameters
    hypothesis = Hypothesis(tuple(terms))
    for name in terms:
        starts = effects()[name.partition("@")[0]].starts
        begin = [0.5 * x for x in starts[len(starts) // 2]]
        values = begun(plant.block, values, SIZES, name, begin)
    p = np.repeat(values[:, None], BLOCK, axis=1)
    init = 0.5 * np.random.default_rng(2).normal(size=(len(s.begin), 4, 1)) + np.zeros(BLOCK)
    if gain is None:
        init[:, 0, 1] += 1e-3
        init[:, 3, 2] += 1e-3
        for key, row in plant.block.memories.items():
            p[row, 6] += 0.1 if key[0] in terms else 0.0
    on, form = switches(hypothesis, 2), replace(plant.form, sizes=ONE_UNIT)
    return roll(s, form, p, on, init, gain, 0 if gain is not None else 2)


def named(effect):
    """Terms of an effect at the second joint; what acts on a whole log acts at the first."""
    return [term(effect, 0 if effects()[effect].port is Port.TIMING else 1)] if effect else []


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
