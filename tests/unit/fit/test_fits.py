"""Fits: what is recovered, from which data, and when they refuse."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.made import TRUE, episode_bytes, mcap_bytes, plant_document
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import BadArtifact, NotAnEpisode, NotIdentifiable, RoleRefused
from trueup.fit.identify import identify
from trueup.fit.least_squares import solve
from trueup.fit.residual import fit_residual
from trueup.fit.score import EVERY, Scoring, rollout_rms, score
from trueup.model.features import FRICTION
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal

EMPS = Path(__file__).parents[3] / "examples" / "emps"
PLANT = Plant.from_document(plant_document())


def episode(seed=0, role=Role.ADAPTATION, **kwargs):
    return read_episode(episode_bytes(seed, role=role, **kwargs), PLANT.layout)


def test_parameters_are_recovered_with_rank_condition_and_intervals():
    predictor, found = identify(PLANT, [episode(0), episode(1)])
    assert predictor.parameters == pytest.approx(TRUE, rel=1e-9)
    assert found.rank == 3
    assert 1.0 <= found.condition < 100.0
    assert set(found.half_widths) == {"k", "c", "b"}
    assert all(0.0 < width < 1e-9 for width in found.half_widths.values())


def test_intervals_of_a_regression_cover_the_truth_under_independent_noise():
    """2000 regressions of three numbers: a 95 % interval covers in 94 to 96 %."""
    rng, truth, hits = np.random.default_rng(0), np.array([1.25, 0.62, 0.82]), 0
    design = rng.normal(size=(150, 3))
    for _ in range(2000):
        found = solve(design, design @ truth + rng.normal(scale=0.3, size=150))
        hits += int((np.abs(found.values - truth) <= found.half_widths).sum())
    assert 0.94 <= hits / 6000 <= 0.96


def test_an_episode_that_excites_nothing_is_refused():
    still = read_episode(
        mcap_bytes(PLANT.layout, np.zeros((60, 2)), np.zeros((60, 1))), PLANT.layout
    )
    with pytest.raises(NotIdentifiable) as refused:
        identify(PLANT, [still])
    assert refused.value.facts["rank"] == 0


def test_nothing_to_fit_is_refused():
    with pytest.raises(NotIdentifiable):
        identify(PLANT, [])


def test_as_many_steps_as_numbers_are_refused_because_nothing_says_how_certain_they_are():
    whole = episode()
    few = len(PLANT.parameters) + 1  # samples, of one step less
    short = replace(
        whole,
        t_s=whole.t_s[:few],
        observations=whole.observations[:few],
        commands=whole.commands[:few],
    )
    with pytest.raises(
        NotIdentifiable, match="3 steps are too few to identify 3 parameters and their uncertainty"
    ) as refused:
        identify(PLANT, [short])
    assert "longer" in refused.value.hint


@pytest.mark.parametrize("role", [r for r in Role if r is not Role.ADAPTATION])
@pytest.mark.parametrize("fit", [identify, fit_residual])
def test_a_fit_reads_adaptation_episodes_alone(fit, role):
    with pytest.raises(RoleRefused):
        fit(PLANT, [episode(), episode(1, role=role)])


def test_a_linear_gap_is_closed_by_the_residual():
    held_out = [episode(5, role=Role.VALIDATION)]
    residual, found = fit_residual(PLANT, [episode()])
    before, after = (
        score(p, held_out, Scoring(2.0, EVERY)).rollout[0] for p in (Nominal(PLANT), residual)
    )
    assert after < 1e-5 * before
    assert found.after_rms[1] < 1e-6 * found.before_rms[1]


def test_an_unknown_feature_is_refused():
    with pytest.raises(BadArtifact):
        fit_residual(PLANT, [episode()], ("q", "os.system"))


@pytest.mark.parametrize("horizon", [2.0])
def test_the_score_is_the_error_norm_in_declared_scales(horizon):
    document, scales = plant_document(), np.array([0.5, 2.0])
    for channel, scale in zip(document["observations"], scales, strict=True):
        channel["scale"] = float(scale)
    plant = Plant.from_document(document)
    held_out = episode(5, role=Role.VALIDATION)
    found = score(Nominal(plant), [held_out], Scoring(horizon))
    states = [held_out.observations[0]]
    for i in range(40):
        states.append(PLANT.update(states[-1][None], held_out.commands[i : i + 1])[0])
    missed = np.array(states[1:]) - held_out.observations[1:41]
    by_hand = np.linalg.norm(missed / scales, axis=1)
    assert found.rollout[0] == pytest.approx(by_hand.mean(), rel=1e-12)
    assert found.one_step[0] == pytest.approx(by_hand[0], rel=1e-12)


@pytest.mark.parametrize("windows", ["first", "every"])
def test_an_episode_without_a_window_is_refused_by_name(windows):
    stamps = np.array([0, 3, 6]) * 10**9
    sparse = read_episode(
        mcap_bytes(
            PLANT.layout, np.zeros((3, 2)), np.zeros((3, 1)), role=Role.VALIDATION, stamps_ns=stamps
        ),
        PLANT.layout,
    )
    with pytest.raises(NotAnEpisode) as refused:
        score(Nominal(PLANT), [sparse], Scoring(2.0, windows))
    assert refused.value.facts["digest"] == sparse.digest


def test_the_first_window_is_the_first_that_can_be_scored():
    """The first sample is 5 s before the others, so its window holds nothing to predict."""
    stamps = np.r_[0, 5_000_000_000 + np.arange(50) * 50_000_000]
    seen = np.zeros((51, 2))
    seen[1:, 0] = np.arange(50.0)  # the windows that follow miss by other amounts
    late = read_episode(
        mcap_bytes(PLANT.layout, seen, np.zeros((51, 1)), role=Role.VALIDATION, stamps_ns=stamps),
        PLANT.layout,
    )
    states = [seen[1]]
    for _ in range(40):
        states.append(PLANT.update(states[-1][None], np.zeros((1, 1)))[0])
    by_hand = np.linalg.norm(np.array(states[1:]) - seen[2:42], axis=1).mean()
    assert score(Nominal(PLANT), [late], Scoring(2.0)).rollout[0] == pytest.approx(by_hand)


def test_friction_features_bring_a_real_axis_below_a_millimetre():
    """EMPS: figures on its validation part, from fits on its adaptation part alone."""
    plant = Plant.from_document(json.loads((EMPS / "plant.json").read_text()))
    episodes = [read_episode(p.read_bytes(), plant.layout) for p in sorted(EMPS.glob("*.mcap"))]
    adaptation, validation = (
        [e for e in episodes if e.role is role] for role in (Role.ADAPTATION, Role.VALIDATION)
    )
    predictors = (
        Nominal(plant),
        identify(plant, adaptation)[0],
        fit_residual(plant, adaptation, FRICTION)[0],
    )
    nominal, identified, friction = (
        max(float(rollout_rms(p, e, 1.0)[0]) for e in validation) for p in predictors
    )
    assert nominal > 0.025
    assert identified < 0.0075
    assert friction < 0.001
