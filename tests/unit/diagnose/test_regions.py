"""Regions: which moments of a recording are in which part of a joint's motion."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.made import episode_bytes, plant_document
from trueup.diagnose.regions import regions, regions_of_samples, used
from trueup.episode.mcap import read_episode
from trueup.model.plant import Plant

PLANT = Plant.from_document(plant_document())
T = np.linspace(0.0, 10.0, 1001)
Q, V, U = np.sin(T), np.cos(T), 2.0 * np.sin(3.0 * T)


@pytest.fixture(scope="module")
def episode():
    return read_episode(episode_bytes(), PLANT.layout)


def test_each_region_holds_the_moments_that_its_name_says():
    turned = np.zeros(len(T), np.bool_)
    inside = regions(Q, V, U, T / T[-1], T, turned)
    top = np.quantile(np.abs(V), 0.99)
    expected = {
        "near zero speed": np.abs(V) < 0.1 * top,
        "at reversals": turned,
        "beyond 80 % of the largest command": np.abs(U) > 1.6,
        "small commands": np.abs(U) < 0.4,
        "upper end of travel": Q > 0.8,
        "lower end of travel": Q < -0.8,
        "fast motion": np.abs(V) > 0.8 * top,
        "late in the episode": T > 10.0 * 2.0 / 3.0,
        "after heavy use": T > 7.5,
    }
    assert inside.keys() == expected.keys()
    for name, mask in inside.items():
        assert np.mean(mask == expected[name]) > 0.998, name  # but for samples at an edge
        assert mask.any() or name == "at reversals"


def test_use_is_the_mean_square_of_what_was_applied_so_far(episode):
    applied = np.full((len(episode.t_s), 1), 3.0)
    use = used(applied, episode)
    assert use[0] == 0.0
    assert use[1:, 0] == pytest.approx(9.0)


def test_reversals_are_around_each_change_of_direction(episode):
    t = episode.t_s
    observations = np.stack([-np.cos(2.0 * t) / 2.0, np.sin(2.0 * t)], axis=1)
    inside = regions_of_samples(PLANT, replace(episode, observations=observations))["at reversals"]
    turns = np.pi / 2.0 * np.arange(1, int(t[-1] / (np.pi / 2.0)) + 1)
    off = np.abs(t[:, None] - turns).min(axis=1)
    assert inside[off < episode.period_s].all()
    assert not inside[off > 0.3].any()


def test_what_leaves_the_declared_envelope_is_outside(episode):
    low, high = PLANT.envelope["q"]
    q = episode.observations[:, 0].copy()
    q[5], q[9] = high + 0.1, low - 0.1
    observations = np.column_stack([q, episode.observations[:, 1:]])
    outside = regions_of_samples(PLANT, replace(episode, observations=observations))
    assert list(np.flatnonzero(outside["outside the envelope"])) == [5, 9]
