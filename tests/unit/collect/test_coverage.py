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


def motion(n):
    """A smooth motion of several frequencies, as a drive makes, `(n,)` each."""
    t = np.linspace(0.0, 60.0, n)
    q, v = (
        sum(f(w * t + w) * w**power for w in (1.0, 2.3, 3.7, 5.1))
        for f, power in ((np.sin, -1), (np.cos, 0))
    )
    return q, v, 0.01 * (np.gradient(v, t) + 2.0 * v + q)  # within the limits of the command


STOOD = np.zeros(900)
DROVE = RNG.uniform(-0.3, 0.3, size=900)


@pytest.mark.parametrize(
    "columns",
    [
        motion(2000),
        motion(20000),
        (STOOD, STOOD, STOOD),
        (STOOD, STOOD, DROVE),
        (DROVE, STOOD, 3.0 * DROVE),
        (DROVE, np.roll(DROVE, 7), DROVE),
    ],
    ids=["motion", "a long motion", "at rest", "held", "a line", "a plane"],
)
def test_whatever_was_recorded_is_inside_its_own_hull(columns):
    (been,) = coverage_of(PLANT, [made(*columns)])
    assert been.outside(np.column_stack(columns))["hull"] == 0.0
    assert len(been.corners) < 1000


def test_beyond_a_thin_hull_is_outside_in_its_plane_too():
    """A stiff drive: the command is nearly the position, and the hull a thin lens."""
    turn = np.linspace(0.0, 40.0 * np.pi, 4000)
    q, v = np.cos(turn), np.sin(turn)
    (been,) = coverage_of(PLANT, [made(q, v, 0.3 * q + 0.003 * RNG.normal(size=4000))])
    beyond = np.array([[0.8, 0.8, 0.24], [-0.9, 0.75, -0.27], [0.78, -0.78, 0.234]])
    shares = been.outside(beyond)
    assert (shares["box"], shares["hull"]) == (0.0, 1.0)
    assert been.outside(0.85 * beyond)["hull"] == 0.0
