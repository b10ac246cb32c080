"""States, windows and rollouts."""

import subprocess
import sys

import numpy as np
import pytest

from tests.support.made import T0_NS, TRUE, episode_bytes, mcap_bytes, plant_document
from trueup.episode.mcap import read_episode
from trueup.errors import BadArtifact
from trueup.model.family import families
from trueup.model.family_kernel import BLOCK, compile_all, rollout
from trueup.model.features import FRICTION, design, known_features
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, LinearMap, Nominal, Residual, predict_observations
from trueup.model.state import known_from, past_states, smoothed_states
from trueup.model.windows import cut, intervals, starts_every

PLANT = Plant.from_document(plant_document())


def position_only(samples=400, dt=0.001, irregular=False):
    document = plant_document()
    document["observations"] = document["observations"][:1]
    document["nominal"]["timestep_s"] = dt
    plant = Plant.from_document(document)
    rng = np.random.default_rng(1)
    t_ns = (
        np.cumsum(rng.integers(500_000, 1_500_000, samples))
        if irregular
        else np.arange(samples) * 1_000_000
    )
    t = (t_ns - t_ns[0]) / 1e9
    q = np.sin(3 * t)[:, None]
    return (
        plant,
        read_episode(
            mcap_bytes(plant.layout, q, np.zeros((samples, 1)), stamps_ns=T0_NS + t_ns),
            plant.layout,
        ),
        3 * np.cos(3 * t),
    )


@pytest.mark.parametrize("irregular", [False, True])
def test_a_velocity_that_nobody_observes_is_the_slope_of_the_positions(irregular):
    plant, episode, truth = position_only(irregular=irregular)
    span = known_from(plant, episode)
    assert 0 < span < 30
    assert np.abs(past_states(plant, episode)[span:, 1] - truth[span:]).max() < 2e-3
    assert np.abs(smoothed_states(plant, episode)[5:-5, 1] - truth[5:-5]).max() < 5e-4


def test_a_state_from_the_past_does_not_depend_on_the_future():
    plant, episode, _ = position_only()
    half = type(episode)(
        episode.t_s[:200].copy(),
        episode.commands[:200].copy(),
        episode.observations[:200].copy(),
        episode.layout,
        episode.role,
        {},
        0,
        "",
    )
    assert np.array_equal(past_states(plant, episode)[:200], past_states(plant, half))


def test_windows_start_at_the_first_sample_at_or_after_each_multiple():
    t = np.array([0.0, 0.4, 0.9, 1.2, 1.9, 2.0, 3.5])
    assert starts_every(t, 1.0).tolist() == [0, 3, 5, 6]


def test_a_start_is_not_lost_to_rounding():
    t = np.arange(100) * 0.05
    assert starts_every(t, 0.15).tolist() == list(range(0, 100, 3))


def test_a_jump_of_the_clock_costs_no_memory_and_windows_go_on_behind_it():
    t = np.r_[0.0, 1.76e9 + np.arange(100) * 0.05]
    assert starts_every(t, 2.0).tolist() == [
        0,
        1,
        *(1 + np.flatnonzero(np.diff(np.floor((t[1:] + 1e-9) / 2.0)) > 0) + 1).tolist(),
    ]


def test_a_start_never_lies_behind_the_last_sample():
    assert starts_every(np.array([0, 0.762394029, 3.242394028]), 0.31, 0.762394029).max() < 3


def test_bursts_of_stamps_and_gaps_do_not_spoil_the_slope():
    document = plant_document()
    document["observations"] = document["observations"][:1]
    plant = Plant.from_document(document)
    bursts = np.sort(np.r_[np.arange(300) * 0.01, np.arange(300) * 0.01 + 1e-6])
    gap = np.r_[np.arange(500) * 0.001, 1.03 + np.arange(500) * 0.001]
    for t, known in ((bursts, slice(20, -20)), (gap, np.r_[10:490, 510:990])):
        q = np.sin(6 * t)[:, None]
        episode = read_episode(
            mcap_bytes(
                plant.layout,
                q,
                np.zeros_like(q),
                stamps_ns=T0_NS + np.rint(t * 1e9).astype(np.int64),
            ),
            plant.layout,
        )
        assert np.abs(past_states(plant, episode)[known, 1] - 6 * np.cos(6 * t)[known]).max() < 0.15


@pytest.mark.parametrize("samples", [2, 3, 4])
def test_a_short_episode_has_a_slope(samples):
    document = plant_document()
    document["observations"] = document["observations"][:1]
    plant = Plant.from_document(document)
    t = np.arange(samples) * 0.05
    episode = read_episode(
        mcap_bytes(plant.layout, 3 * t[:, None], np.zeros((samples, 1))), plant.layout
    )
    assert past_states(plant, episode)[-1, 1] == pytest.approx(3.0, rel=1e-6)


def test_intervals_are_whole_steps_of_about_the_declared_length():
    h, n = intervals(np.array([0.0, 0.05, 0.1 + 1e-12, 0.16, 0.5]), 0.05)
    assert n.tolist() == [1, 1, 1, 7, 0]
    assert h[:2].tolist() == [0.05, 0.05]
    assert h[3] * 7 == pytest.approx(0.34)


def test_windows_cover_every_sample_once():
    episode = read_episode(episode_bytes(samples=107), PLANT.layout)
    windows = cut(PLANT, episode, starts_every(episode.t_s, 0.5))
    assert windows.rows[windows.inside].tolist() == list(range(107))


def test_the_true_model_predicts_its_own_episode_to_rounding():
    episode = read_episode(episode_bytes(), PLANT.layout)
    windows = cut(PLANT, episode, starts_every(episode.t_s, 2.0))
    predicted = predict_observations(Identified(PLANT, TRUE), windows)[windows.inside]
    assert np.abs(predicted - episode.observations).max() < 1e-12


def test_stepwise_and_compiled_rollouts_agree_on_irregular_times():
    rng = np.random.default_rng(2)
    stamps = T0_NS + np.cumsum(rng.integers(20_000_000, 180_000_000, 90))
    episode = read_episode(
        mcap_bytes(
            PLANT.layout, rng.normal(size=(90, 2)), rng.uniform(-2, 2, (90, 1)), stamps_ns=stamps
        ),
        PLANT.layout,
    )
    windows = cut(PLANT, episode, starts_every(episode.t_s, 1.0))
    nothing = Residual(PLANT, LinearMap(("1",), np.zeros((1, 2))))
    assert np.allclose(
        nothing.rollout(windows), Nominal(PLANT).rollout(windows), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("vectors", [1, 3, BLOCK // 4, BLOCK, BLOCK + 1, 100])
def test_any_number_of_lanes_gives_the_same_rollouts(vectors):
    rng = np.random.default_rng(3)
    parameters = rng.uniform(0.5, 1.5, (vectors, 3))
    windows, samples = 5, 400
    arguments = (
        rng.normal(size=(windows, 2)),
        rng.uniform(-1, 1, (windows, samples)),
        np.full((windows, samples), 0.05),
        np.ones((windows, samples), np.int64),
    )
    found = rollout(families()["oscillator"], parameters, *arguments)
    assert found.shape == (vectors, windows, samples, 2)
    for i in (0, vectors - 1):
        assert np.allclose(
            rollout(families()["oscillator"], parameters[i : i + 1], *arguments)[0],
            found[i],
            rtol=1e-13,
            atol=1e-13,
        )


def test_features_are_products_of_known_factors():
    states, issued = np.array([[0.5, -2.0]]), np.array([[3.0]])
    assert design(
        ("1", "q*v", "sign(v)", "abs(v)", "k*q"), states, issued, {"k": 4.0}
    ).tolist() == [[1.0, -1.0, -1.0, 2.0, 2.0]]
    known_features(FRICTION, ())


@pytest.mark.parametrize("feature", ["__import__('os')", "q**2", "w", "", "q*"])
def test_an_unknown_feature_is_refused_and_never_evaluated(feature):
    with pytest.raises(BadArtifact):
        known_features((feature,), ("k", "c", "b"))


def test_a_predictor_that_runs_away_says_so_in_its_numbers():
    wild = Residual(PLANT, LinearMap(("q*q", "v*v"), np.full((2, 2), 50.0)))
    episode = read_episode(episode_bytes(), PLANT.layout)
    assert not np.isfinite(wild.rollout(cut(PLANT, episode, starts_every(episode.t_s, 5.0)))).all()


def test_a_kernel_is_compiled_once_and_then_loaded_by_every_process():
    code = (
        "import numpy as np; from trueup.model import family_kernel; from "
        "trueup.model.family import families\n"
        "for name, family in families().items():\n"
        "    for width, vectors in ((family_kernel.ALONE, 1), (family_kernel.BLOCK, "
        "family_kernel.BLOCK)):\n"
        "        z = np.zeros((1, 2)); p = np.ones((vectors, len(family.params)))\n"
        "        family_kernel.rollout(family, p, z, z, z, np.zeros((1, 2), np.int64))\n"
        "        assert family_kernel.kernel(family, width).stats.cache_hits.total() == 1, name\n"
    )
    compile_all()
    subprocess.run([sys.executable, "-c", code], check=True)
