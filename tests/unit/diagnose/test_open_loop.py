"""Open loop: the chapter's errors by steps, the bound beside them, and each premise that data may
break."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.made import TRUE, corrected, plant_document
from trueup.chapter.data import DEPLOYMENT, PLANT, draw
from trueup.chapter.published import PUBLISHED
from trueup.diagnose.open_loop import open_loop, rollout_bound
from trueup.fit.randomised import fit_blind, fit_conditioned
from trueup.fit.residual import fit_residual
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal

TRUTH = "truth", Identified(PLANT, DEPLOYMENT)


@pytest.fixture(scope="module")
def data():
    return draw()


@pytest.fixture(scope="module")
def chapter(data):
    models = {
        "nominal": Nominal(PLANT),
        "blind": fit_blind(PLANT, data.pooled),
        "conditioned": fit_conditioned(PLANT, data.pooled, DEPLOYMENT),
        "residual": fit_residual(PLANT, [data.adaptation])[0],
    }
    return open_loop(models, TRUTH, [data.test])


def premises(document, model=0):
    of_all = {p["premise"]: p for p in document["premises"]}
    return of_all | {p["premise"]: p for p in document["models"][model]["premises"]}


def test_the_chapters_errors_come_out_digit_by_digit(chapter):
    assert [m["model"] for m in chapter["models"]] == list(PUBLISHED["Open loop"])
    for model in chapter["models"]:
        printed = {str(e["steps"]): f"{e['mean']:.4f}" for e in model["errors"]}
        assert printed == PUBLISHED["Open loop"][model["model"]]
        assert [e["windows"] for e in model["errors"]] == [1, 1, 1, 1]


def test_the_bound_of_a_linear_plant_is_worked_out_from_its_matrix(chapter, data):
    matrix = PLANT.dynamics.transition(np.array(DEPLOYMENT), PLANT.timestep_s)
    assert chapter["lipschitz"] == pytest.approx(np.linalg.norm(matrix, 2), rel=1e-6)
    nominal = chapter["models"][0]
    states = data.test.observations
    steps = PLANT.update(states[:-1], data.test.commands[:-1]) - states[1:]
    assert nominal["defect"] == pytest.approx(np.linalg.norm(steps, axis=1).max(), rel=1e-9)
    for error in nominal["errors"]:
        expected = rollout_bound(nominal["defect"], chapter["lipschitz"], error["steps"])
        assert error["bound"] == pytest.approx(expected)
        assert not error["exceeds"]


def test_the_bound_is_zero_without_a_step_linear_at_one_and_infinite_where_it_overflows():
    assert rollout_bound(0.1, 1.5, 0) == 0.0
    assert rollout_bound(0.001, 1.0, 50) == pytest.approx(0.05)
    assert rollout_bound(0.1, 2.0, 3) == pytest.approx(0.7)
    assert rollout_bound(1.0, 10.0, 1000) == np.inf


def test_of_noiseless_data_that_a_model_explains_every_premise_holds(chapter, data):
    held = premises(open_loop({"truth": TRUTH[1]}, TRUTH, [data.test]))
    assert {name for name, p in held.items() if p["holds"] is not True} == {"no_memory"}
    assert held["no_memory"]["holds"] is None  # for nobody has diagnosed the machine


def test_a_rollout_that_goes_where_the_defect_was_not_measured_breaks_a_premise(chapter):
    broken = premises(chapter)["defect_holds_where_it_goes"]
    assert broken["holds"] is False
    assert broken["outside"] > 0.5
    assert broken["defect_there"] > chapter["models"][0]["defect"]


def with_noise(episode, size):
    rng = np.random.default_rng(0)
    noisy = episode.observations + size * rng.normal(size=episode.observations.shape)
    return replace(episode, observations=noisy)


def test_noise_of_the_start_breaks_a_premise(data):
    document = open_loop({"truth": TRUTH[1]}, TRUTH, [with_noise(data.test, 0.003)])
    assert premises(document)["equal_starts"]["holds"] is False
    assert document["noise"] == pytest.approx(0.003 * np.sqrt(2.0), rel=0.2)


def test_an_error_above_the_bound_is_told_with_the_premises_that_are_broken(data):
    unstable = Identified(PLANT, (-40.0, 0.0, 1.0))
    document = open_loop({"unstable": unstable}, TRUTH, [data.test])
    assert [e["exceeds"] for e in document["models"][0]["errors"]] == [False, True, True, True]
    held = premises(document)
    assert held["lipschitz"]["share"] > 0.5
    assert not held["lipschitz"]["holds"]
    assert not held["defect_holds_where_it_goes"]["holds"]


def test_a_velocity_that_nobody_observes_breaks_a_premise_and_has_a_scale_of_its_own(data):
    document = plant_document()
    document["observations"] = [{"name": "q", "unit": "m", "scale": 0.5}]
    plant = Plant.from_document(document)
    assert plant.state_scales.tolist() == [0.5, 0.25]  # a scale in a horizon of 2 s
    episode = replace(
        data.test, observations=data.test.observations[:, :1].copy(), layout=plant.layout
    )
    nominal = Nominal(plant)
    held = premises(open_loop({"nominal": nominal}, ("nominal", nominal), [episode], (1, 10)))
    assert held["state_observed"]["holds"] is False


def test_stamps_off_the_declared_step_break_a_premise(data):
    t_s = np.array(data.test.t_s)
    t_s[1::2] += 0.01
    document = open_loop({"truth": TRUTH[1]}, TRUTH, [replace(data.test, t_s=t_s)])
    held = premises(document)["one_step_length"]
    assert (held["holds"], held["worst"]) == (False, pytest.approx(0.2))


def test_what_a_diagnosed_machine_remembers_breaks_a_premise(data):
    lag = corrected(PLANT, {"actuator_lag": {"time_constant": 0.2}}, TRUE)
    drag = corrected(PLANT, {"quadratic_drag": {"coefficient": 0.2}}, TRUE)
    for machine, expected in ((lag, False), (drag, True)):
        document = open_loop({"nominal": Nominal(PLANT)}, ("diagnosis", machine), [data.test])
        assert premises(document)["no_memory"]["holds"] is expected


def test_recordings_shorter_than_a_horizon_leave_it_empty(data):
    short = replace(
        data.test,
        t_s=data.test.t_s[:31],
        observations=data.test.observations[:31],
        commands=data.test.commands[:31],
    )
    document = open_loop({"nominal": Nominal(PLANT)}, TRUTH, [short])
    errors = {e["steps"]: e for e in document["models"][0]["errors"]}
    assert (errors[50]["mean"], errors[50]["windows"], errors[50]["exceeds"]) == (None, 0, None)
    assert errors[10]["windows"] == 1
    json.dumps(document, allow_nan=False)


def test_nothing_to_roll_out_is_refused(data):
    with pytest.raises(ValueError, match="a model and an episode"):
        open_loop({}, TRUTH, [data.test])
    with pytest.raises(ValueError, match="a model and an episode"):
        open_loop({"nominal": Nominal(PLANT)}, TRUTH, [])
