"""Coverage: box, hull and density are three answers, and the declared envelope is a fourth."""

import numpy as np
import pytest

from tests.support.made import TRUE, episode_bytes, plant_document
from trueup.collect.coverage import Coverage, compared, coverage_of
from trueup.collect.measured import measured
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.model.plant import Plant

PLANT = Plant.from_document(plant_document())
RNG = np.random.default_rng(5)


def made(q, v, u):
    t = np.arange(len(q)) * 0.05
    return Episode(
        t,
        np.array(u)[:, None].copy(),
        np.column_stack([q, v]),
        PLANT.layout,
        Role.ADAPTATION,
        {},
        0,
        "made",
    )


def ring(n, size=1.0, inner=0.0):
    """Samples on a ring in position and velocity, filled to the `inner` radius."""
    turn, radius = np.linspace(0.0, 40.0 * np.pi, n), np.sqrt(RNG.uniform(inner**2, 1.0, n)) * size
    return radius * np.cos(turn), radius * np.sin(turn), 0.2 * np.sin(3.0 * turn)


@pytest.fixture(scope="module")
def been():
    return coverage_of(PLANT, [made(*ring(2000))])


def test_what_was_recorded_again_is_inside_everything(been):
    shares = compared(PLANT, made(*ring(800)), been, warnings := [])["joint"]
    assert max(shares.values()) < 0.05
    assert warnings == []


def test_a_corner_of_the_box_is_inside_the_box_and_outside_the_hull(been):
    corner = made(*(np.full(50, 0.95), np.full(50, 0.95), np.zeros(50)))
    shares = been[0].outside(np.column_stack([corner.observations, corner.commands]))
    assert (shares["box"], shares["hull"]) == (0.0, 1.0)


def test_a_hole_is_inside_the_hull_and_outside_the_density():
    around = coverage_of(PLANT, [made(*ring(2000, inner=0.8))])
    middle = np.zeros((50, 3))
    shares = around[0].outside(middle)
    assert (shares["box"], shares["hull"], shares["density"]) == (0.0, 0.0, 1.0)


def test_what_goes_further_is_told_in_words_though_the_envelope_allows_it(been):
    small = coverage_of(PLANT, [made(*ring(2000, size=0.3))])
    record = measured(PLANT, made(*ring(400, size=0.8)), small)
    assert record["envelope"]["breaches"] == {}
    assert record["outside"]["joint"]["hull"] > 0.5
    assert any("outside of what the serving model was fitted on" in w for w in record["warnings"])


def test_it_comes_back_from_its_document(been):
    again = Coverage.from_document(been[0].document())
    triples = RNG.uniform(-1.5, 1.5, (100, 3))
    assert again.outside(triples) == been[0].outside(triples)


def test_a_real_run_of_the_same_kind_is_mostly_inside():
    episodes = [read_episode(episode_bytes(i, parameters=TRUE), PLANT.layout) for i in range(6)]
    shares = compared(
        PLANT,
        read_episode(episode_bytes(7, parameters=TRUE), PLANT.layout),
        coverage_of(PLANT, episodes),
        [],
    )
    assert shares["joint"]["hull"] < 0.3
