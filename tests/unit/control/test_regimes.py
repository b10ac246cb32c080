"""Regimes: the chapter's closed-loop figures from data, and what a study says of itself."""

import json

import numpy as np
import pytest

from tests.support.made import TRUE, corrected, plant_document
from tests.support.robots import arm_plant
from trueup.chapter.data import DEPLOYMENT, PLANT, draw
from trueup.chapter.published import PUBLISHED
from trueup.control.courses import Courses, Travelled
from trueup.control.machine import Diagnosed, Predicted, machine_of, with_authority
from trueup.control.regimes import Conditions, run_regimes
from trueup.errors import NotIdentifiable
from trueup.fit.randomised import fit_blind, fit_conditioned
from trueup.fit.residual import fit_residual
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal

CHAPTER = Courses.declared(PLANT, 0.55, 0.15, 200, 0.02)
REGIMES = {
    "nominal": "nominal plant",
    "shifted": "deployment plant",
    "delayed": "deployment + sensor delay of 3",
    "reduced_authority": "deployment + u_max 0.5",
}
TRUTH = "truth", Predicted(Identified(PLANT, DEPLOYMENT))
ONE = Conditions(seeds=(0,))


@pytest.fixture(scope="module")
def chapter():
    data = draw()
    models = {
        "nominal": Nominal(PLANT),
        "blind": fit_blind(PLANT, data.pooled),
        "conditioned": fit_conditioned(PLANT, data.pooled, DEPLOYMENT),
        "residual": fit_residual(PLANT, [data.adaptation])[0],
    }
    conditions = Conditions(seeds=(7,), sweep_ticks=(0, 1, 2, 3, 5, 8))
    return run_regimes(TRUTH, models, CHAPTER, conditions)


@pytest.mark.slow
def test_the_chapters_tracking_errors_come_out_digit_by_digit(chapter):
    table = PUBLISHED["Tracking error"]
    assert [r["regime"] for r in chapter["regimes"]] == list(REGIMES)
    for regime in chapter["regimes"]:
        printed = table[REGIMES[regime["regime"]]]
        assert {m["model"]: f"{m['tracking']:.5f}" for m in regime["models"]} == printed
        assert all(m["breaches"] == {"share": 0.0, "runs": 0} for m in regime["models"])


@pytest.mark.slow
def test_the_chapters_sweep_falls_with_delay_and_is_mended_by_stamps(chapter):
    nominal = [s for s in chapter["sweep"] if s["model"] == "nominal"]
    assert [s["delay_ticks"] for s in nominal] == [0, 1, 2, 3, 5, 8]
    errors = [s["tracking"] for s in nominal]
    assert errors == sorted(errors, reverse=True)
    conditioned = [s["stamped"] for s in chapter["sweep"] if s["model"] == "conditioned"]
    assert conditioned == pytest.approx([conditioned[0]] * 6, rel=1e-6)


@pytest.mark.slow
def test_issued_and_applied_commands_are_both_in_the_document(chapter):
    reduced = next(r for r in chapter["regimes"] if r["regime"] == "reduced_authority")
    for model in reduced["models"]:
        applied = np.array(model["drawn"]["applied"])
        assert applied.shape == np.array(model["drawn"]["issued"]).shape == (1, 200)
        assert np.abs(applied).max() <= 0.5


def test_what_is_issued_beyond_the_limits_is_not_applied():
    machine = with_authority(Predicted(Nominal(PLANT)), 0.5)
    assert machine.applied(np.array([[0.9], [-0.2], [-7.0]])).tolist() == [[0.5], [-0.2], [-0.5]]
    after = [machine.after(np.zeros((1, 2)), np.array([[u]]), 3) for u in (0.9, 0.5)]
    assert np.array_equal(*after)


def test_authority_shrinks_a_lopsided_range_about_its_middle():
    document = plant_document()
    document["commands"][0]["limits"] = [0.0, 2.0]
    plant = Plant.from_document(document)
    assert [float(x[0]) for x in plant.limits_at(0.5)] == [0.5, 1.5]
    assert [float(x[0]) for x in plant.limits_at(1.0)] == [0.0, 2.0]


def test_a_diagnosed_machine_remembers_from_tick_to_tick():
    plant = Plant.from_document(plant_document())
    lag = corrected(plant, {"actuator_lag": {"time_constant": 0.4}}, TRUE)
    machine = machine_of(lag)
    assert isinstance(machine, Diagnosed)
    issued = np.ones((5, 1))
    states = np.zeros((6, 2))
    for t in range(5):
        states[t + 1] = machine.after(states[: t + 1], issued[: t + 1], 2)
    whole = lag.run(np.zeros(2), np.ones((11, 1)))
    np.testing.assert_allclose(states, whole[::2], atol=1e-12)


def test_without_a_known_shift_the_shifted_regime_is_left_out_with_its_reason():
    nominal = Nominal(PLANT)
    document = run_regimes(("nominal", Predicted(nominal)), {"nominal": nominal}, CHAPTER, ONE)
    assert [r["regime"] for r in document["regimes"]] == [
        "nominal",
        "delayed",
        "reduced_authority",
    ]
    (left,) = document["left_out"]
    assert left["regime"] == "shifted"
    assert "nobody has diagnosed or identified" in left["why"]
    assert document["machine"]["stands_in"] == "the nominal plant as declared"


def test_breaches_are_shares_of_states_and_none_without_an_envelope():
    def plant(envelope):
        return Plant.from_document({**PLANT.document, "envelope": envelope})

    tight, open_ = plant({"q": [-0.3, 0.3]}), plant({})
    for each, expected in ((tight, True), (open_, False)):
        courses = Courses.declared(each, 0.55, 0.15, 50, 0.02)
        stand_in = "truth", Predicted(Identified(each, DEPLOYMENT))
        document = run_regimes(stand_in, {"nominal": Nominal(each)}, courses, ONE)
        (model,) = document["regimes"][1]["models"]
        if expected:
            positions = np.array(model["drawn"]["positions"][0])
            share = np.mean(np.abs(np.append(0.0, positions)) > 0.3)
            assert model["breaches"] == {"share": pytest.approx(share), "runs": 1}
        else:
            assert model["breaches"] is None


def test_a_run_that_runs_away_is_counted_and_written_down():
    wild = Identified(PLANT, (-1e6, 0.0, 1.0))
    document = run_regimes(("wild", Predicted(wild)), {"nominal": Nominal(PLANT)}, CHAPTER, ONE)
    (model,) = document["regimes"][1]["models"]
    assert (model["tracking"], model["ran_away"]) == (None, 1)
    json.dumps(document, allow_nan=False)


def test_progress_ends_at_one_and_the_baseline_is_the_first_model():
    seen = []
    models = {"identified": Identified(PLANT, DEPLOYMENT), "nominal": Nominal(PLANT)}
    travelled = Travelled(np.array([-0.5]), np.array([0.5]), np.ones(1), np.ones(1, bool))
    courses = Courses.within(PLANT, travelled, 10)
    document = run_regimes(TRUTH, models, courses, Conditions(("shifted",), (0, 1)), seen.append)
    assert seen == pytest.approx([i / 12 for i in range(1, 13)])
    assert document["baseline"] == "identified"
    first, second = document["regimes"][0]["models"]
    assert (first["change"], first["change_ci95"]) == (0.0, [0.0, 0.0])
    assert second["change_ci95"][0] <= second["change"] <= second["change_ci95"][1]


def test_a_robot_takes_no_single_sine(tmp_path):
    with pytest.raises(NotIdentifiable, match="single joint"):
        Courses.declared(arm_plant(tmp_path), 0.5, 0.1, 10, None)


def test_nothing_to_run_is_refused():
    with pytest.raises(ValueError, match="need a model"):
        run_regimes(TRUTH, {}, CHAPTER, ONE)
    with pytest.raises(ValueError, match="need a model"):
        run_regimes(TRUTH, {"nominal": Nominal(PLANT)}, CHAPTER, Conditions(seeds=()))
