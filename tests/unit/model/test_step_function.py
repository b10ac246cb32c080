"""One step at a time, by numpy alone, is what the compiled rollout does."""

import numpy as np
import pytest

from tests.support.made import TRUE, plant_document
from tests.support.robots import arm_plant
from trueup.errors import NotExportable
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.model.block import BLOCK
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
    stepper = StepFunction.of(model)
    state, found = stepper.begin(*(np.full(3, x) for x in start), np.full(3, issued[0, 0])), []
    for u in issued[:, 0]:
        seen, state = stepper.step(state, np.full(3, u))
        found.append([x[1] for x in seen])
    return np.array(found)


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
    stepper, states = StepFunction.of(model), np.random.default_rng(1).normal(size=(5, 2))
    issued = np.linspace(-9.0, 9.0, 5)
    seen, after = stepper.step(stepper.begin(states[:, 0], states[:, 1], issued), issued)
    assert np.array_equal(np.stack(seen, axis=1), PLANT.observe(states))
    assert np.allclose(
        np.stack([after["position"], after["velocity"]], axis=1),
        model.predict_batch(states, issued[:, None]),
        atol=1e-13,
    )


def test_a_robot_of_several_joints_has_no_such_step(tmp_path):
    with pytest.raises(NotExportable, match="given as MJCF"):
        StepFunction.of(Nominal(arm_plant(tmp_path)))


def test_a_delay_takes_its_commands_from_the_state():
    stepper = StepFunction.of(corrected(("actuator_delay",), DECLARED))
    assert len(stepper.shares[0]) > 1
    assert sum(stepper.shares[0]) == pytest.approx(1.0)
    assert stepper.names[2:] == tuple(
        f"command {k} before" for k in range(1, len(stepper.shares[0]))
    )
