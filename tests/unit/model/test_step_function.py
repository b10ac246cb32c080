"""One step at a time, by numpy alone, is what the compiled rollout does."""

import numpy as np
import pytest

from tests.support import made
from tests.support.made import TRUE, plant_document
from tests.support.robots import ARM, branched_plant, plant_of
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.model.block import BLOCK, term
from trueup.model.corrected import Corrected
from trueup.model.effect import effects
from trueup.model.features import FRICTION
from trueup.model.hypothesis import Hypothesis, Scales, switches
from trueup.model.plant import Plant
from trueup.model.predictor import Blind, Identified, LinearMap, Nominal, Residual
from trueup.model.roll import roll
from trueup.model.series import DECLARED, Scheme, unobserved
from trueup.model.step_function import StepFunction

PLANT = Plant.from_document(plant_document())
SAMPLES = 120
ALL = tuple(effects())
TOGETHER = (
    "actuator_delay",
    "actuator_lag",
    "saturation",
    "backlash",
    "stribeck_friction",
    "cogging",
    "sensor_drift",
    "velocity_lag",
)


def corrected(names, scheme):
    """A plant with effects whose numbers are those from which a fit begins."""
    fitter = Fitter(
        PLANT.form,
        Directions.of_family(PLANT.dynamics.parameter_names),
        [Scales(0.6, 0.5, 0.7, 1.0)],
        np.ones(2),
    )
    values, hypothesis = fitter.initial_values((1.2, 0.6, 0.8)), Hypothesis()
    for name in names:
        values = fitter.with_effect(values, name, np.nan_to_num(effects()[name].starts[0], nan=0.1))
        hypothesis |= name
    return Corrected(PLANT, hypothesis, tuple(map(float, values)), scheme)


def commands(seed=0):
    t = np.arange(SAMPLES) * PLANT.timestep_s
    rng = np.random.default_rng(seed)
    return (1.4 * np.sin(1.7 * t) + 0.4 * rng.standard_normal(SAMPLES))[:, None]


def compiled(model, start, issued):
    """The kernel's rollout from a start, by nobody's observations."""
    t_s = np.arange(len(issued)) * PLANT.timestep_s
    s = unobserved(model.scheme, t_s, PLANT.applied(issued), PLANT.command_scales, PLANT.timestep_s)
    init = np.repeat(np.array(start)[None, :, None], BLOCK, axis=2)
    values = np.repeat(np.array(model.values)[:, None], BLOCK, axis=1)
    return roll(s, PLANT.form, values, switches(model.hypothesis, 1), init)[
        :, PLANT.state_columns, 0
    ]


def stepped(model, start, issued):
    """A rollout of three lanes, one step at a time, of which the middle one is returned."""
    step_function = StepFunction.of(model)
    q, v, u = ([np.full(3, x) for x in part] for part in (*np.split(np.array(start), 2), issued[0]))
    state, rows = step_function.begin(q, v, u), []
    for command in issued:
        seen, state = step_function.step(state, [np.full(3, x) for x in command])
        rows.append([x[1] for x in seen])
    return np.array(rows)


@pytest.mark.parametrize("scheme", [DECLARED, Scheme(0.5, 3)], ids=["declared", "symmetric"])
@pytest.mark.parametrize(
    "names", [(), *((n,) for n in ALL), TOGETHER], ids=lambda n: "+".join(n) or "none"
)
def test_a_step_at_a_time_is_the_compiled_rollout(names, scheme):
    model, start, issued = corrected(names, scheme), (0.3, -0.2), commands()
    one, other = stepped(model, start, issued), compiled(model, start, issued)
    assert np.ptp(other[:, 0]) > 0.1
    assert np.abs(one - other).max() < 1e-9


@pytest.mark.parametrize(
    "model",
    [
        Nominal(PLANT),
        Identified(PLANT, TRUE),
        Residual(PLANT, LinearMap(FRICTION, np.random.default_rng(0).normal(size=(5, 2)) * 1e-2)),
        Blind(
            PLANT,
            LinearMap(
                ("q", "v", "u", "q*v"),
                np.array([[0.99, -0.05], [0.05, 0.97], [0.0, 0.04], [0.01, 0.0]]),
            ),
        ),
    ],
    ids=lambda m: m.kind,
)
def test_every_kind_of_predictor_steps_as_it_predicts(model):
    step_function, states = StepFunction.of(model), np.random.default_rng(1).normal(size=(5, 2))
    issued = np.linspace(-9.0, 9.0, 5)
    begun = step_function.begin([states[:, 0]], [states[:, 1]], [issued])
    seen, after = step_function.step(begun, [issued])
    assert np.array_equal(np.stack(seen, axis=1), PLANT.observe(states))
    assert np.allclose(
        np.stack([after["position"], after["velocity"]], axis=1),
        model.predict_batch(states, issued[:, None]),
        atol=1e-13,
    )


# a hinge with a servo, one with a motor, one with a motor of limited force; two effects at a servo
AT_JOINTS = (
    *((name, j) for name in ALL for j in (2, 0)),
    ("stribeck_friction", 4),
    ("elastic_transmission", 3),
)
ROBOTS = {
    "none": (),
    **{f"{name} at {j}": ((name, j),) for name, j in AT_JOINTS},
    "frictions": (("coulomb_friction", 0), ("stribeck_friction", 2), ("coulomb_friction", 3)),
    "everywhere": (
        ("clock_skew", 0), ("actuator_delay", 0), ("elastic_transmission", 0),
        ("quadratic_drag", 1), ("sensor_delay", 2), ("thermal_derating", 2), ("deadband", 3),
        ("load_dependent_friction", 3), ("hysteresis", 4), ("sensor_bias", 4),
    ),
}  # fmt: skip


def robot(at, scheme):
    """A robot of hinges and a slide in branches, with effects at joints by their numbers."""
    plant = branched_plant()
    scales, by_term = Scales(0.6, 1.5, 6.0, 10.0, 0.3), {}
    for name, j in at:
        starts = np.nan_to_num(effects()[name].starts[0], nan=0.1)
        by_term[term(name, j)] = {
            n.name: x * scales.of(n.scale)
            for x, n in zip(starts, effects()[name].params, strict=True)
        }
    return made.corrected(plant, by_term, None, scheme)


def robot_motion(plant):
    """A start of the robot, and commands."""
    rng, t = np.random.default_rng(2), np.arange(SAMPLES) * plant.timestep_s
    issued = np.stack([3.0 * np.sin(9.0 * t + phase) for phase in (0.0, 1.0, 2.0)], 1)
    issued += 0.5 * rng.standard_normal(issued.shape)
    return np.concatenate([rng.uniform(-0.3, 0.3, 5), rng.uniform(-0.5, 0.5, 5)]), issued


@pytest.mark.parametrize("scheme", [DECLARED, Scheme(0.5, 2)], ids=["declared", "symmetric"])
@pytest.mark.parametrize("at", ROBOTS.values(), ids=ROBOTS)
def test_a_robots_step_is_the_compiled_rollout(at, scheme):
    model = robot(at, scheme)
    start, issued = robot_motion(model.plant)
    one, other = stepped(model, start, issued), model.plant.observe(model.run(start, issued))
    assert np.ptp(other[:, 0]) > 0.1
    assert np.abs(one - other).max() < 1e-9


def test_every_kind_of_a_robots_predictor_steps_as_it_predicts(tmp_path):
    plant, rng = plant_of(tmp_path, ARM, ["shoulder", "elbow"]), np.random.default_rng(1)
    learnt = LinearMap(("q", "v1", "u1", "sign(v)"), rng.normal(size=(4, 4)) * 1e-2)
    states, issued = rng.normal(size=(5, 4)), rng.uniform(-40.0, 40.0, size=(5, 2))
    for model in (
        Nominal(plant),
        Identified(plant, plant.parameters),
        Residual(plant, learnt),
        Blind(plant, learnt),
    ):
        step_function = StepFunction.of(model)
        begun = step_function.begin(list(states[:, :2].T), list(states[:, 2:].T), list(issued.T))
        _, after = step_function.step(begun, list(issued.T))
        names = [f"{what}({joint})" for what in ("position", "velocity") for joint in plant.joints]
        moved = np.stack([after[name] for name in names], axis=1)
        assert np.allclose(moved, model.predict_batch(states, issued), atol=1e-12), model.kind


def test_a_delay_takes_its_commands_from_the_state():
    step_function = StepFunction.of(corrected(("actuator_delay",), DECLARED))
    shares = step_function.shares[0][0]
    assert len(shares) > 1
    assert sum(shares) == pytest.approx(1.0)
    assert step_function.names[2:] == tuple(f"command {k} before" for k in range(1, len(shares)))
