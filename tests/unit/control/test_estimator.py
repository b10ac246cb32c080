"""The state now, from observations that came late, irregularly and out of order."""

import numpy as np
import pytest

from tests.support.made import TRUE, plant_document
from tests.unit.control.test_closed_loop import MACHINE, compare, true, went
from trueup.control.estimator import Estimator, transport_delay_s
from trueup.control.loop import run_loop
from trueup.control.machine import Predicted
from trueup.control.planner import RandomShooting
from trueup.errors import NotIdentifiable
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal

PLANT = Plant.from_document(plant_document())
MODEL = Identified(PLANT, TRUE)
DT = PLANT.timestep_s
COMMANDS = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 1))


def driven(start=(0.1, 0.0)):
    states = [np.array(start)]
    for command in COMMANDS:
        states.append(MODEL.predict_batch(states[-1][None, :], command[None, :])[0])
    return np.array(states)


STATES = driven()


def fed(observations):
    estimator = Estimator(MODEL)
    for i, command in enumerate(COMMANDS):
        estimator.commanded(i * DT, command)
    for i in observations:
        estimator.observed(i * DT, STATES[i])
    return estimator


@pytest.mark.parametrize("seen", [0, 7, 39])
def test_a_late_observation_is_brought_forward_through_the_commands_since(seen):
    assert fed([seen]).state(40 * DT) == pytest.approx(STATES[40], abs=1e-12)


def test_what_arrives_out_of_order_changes_nothing():
    estimator = fed([20])
    assert estimator.observed(12 * DT, np.array([9.0, 9.0])) is False
    assert estimator.observed(30 * DT, np.array([np.nan, 0.0])) is False
    assert estimator.state(40 * DT) == pytest.approx(STATES[40], abs=1e-12)


def test_stamps_between_samples_take_shorter_steps():
    estimator = fed([10])
    between = estimator.state(10.5 * DT)
    half = MODEL.predict_batch(STATES[10][None, :], COMMANDS[10][None, :], 0.5 * DT)[0]
    assert between == pytest.approx(half, abs=1e-12)
    late = Estimator(MODEL)
    late.commanded(0.0, np.array([0.5]))
    late.commanded(0.3 * DT, np.array([-0.5]))
    late.observed(0.0, STATES[0])
    one = MODEL.predict_batch(STATES[0][None, :], np.array([[0.5]]), 0.3 * DT)
    assert late.state(DT) == pytest.approx(
        MODEL.predict_batch(one, np.array([[-0.5]]), 0.7 * DT)[0], abs=1e-12
    )


def test_before_anything_was_seen_it_refuses():
    with pytest.raises(NotIdentifiable, match="observed"):
        Estimator(MODEL).state(1.0)


def test_it_forgets_what_is_past():
    estimator = fed([39])
    assert len(estimator._times_s) == len(estimator._commands) == 1


@pytest.mark.parametrize("delays", [(3,), (8,), (3, 0, 5, 2, 8, 1)])
def test_with_a_right_model_late_sensors_cost_nothing(delays):
    reference = 0.3 * np.sin(0.05 * np.arange(120))[:, None]

    def error(delays, *, stamped):
        run = run_loop(
            Predicted(MODEL),
            RandomShooting(MODEL),
            reference,
            np.random.default_rng(0),
            delays=delays,
            stamped=stamped,
        )
        return run.tracking_error(reference)

    prompt = error((0,), stamped=False)
    assert error(delays, stamped=True) == pytest.approx(prompt, rel=1e-9)
    assert error(delays, stamped=False) != pytest.approx(prompt, rel=0.01)


@pytest.mark.slow
def test_a_model_that_knows_the_delay_tracks_better():
    late = true(actuator_delay={"delay": 0.5})
    assert transport_delay_s(late) == 0.5
    assert transport_delay_s(Nominal(PLANT)) == transport_delay_s(MACHINE) == 0.0
    tracking = compare(late, late, MACHINE, went(0.5))
    assert tracking.candidate.mean() < 0.8 * tracking.incumbent.mean()
    assert tracking.document()["change_ci95"][1] < 0.0
