"""A scan for spatial periods takes recordings of any length."""

from dataclasses import replace

import pytest

from tests.support.simulated import recorded
from trueup.diagnose.data_quality import assess
from trueup.diagnose.problem_setup import Recordings
from trueup.diagnose.spatial_periods import spatial_periods


@pytest.fixture(scope="module")
def case():
    plant, episodes, _ = recorded("A1", ["cogging"], 12)
    adaptation = Recordings.of(plant, episodes).adaptation
    return plant, assess(plant, adaptation), list(adaptation)


def first(episode, samples):
    """The first samples of an episode."""
    return replace(
        episode,
        t_s=episode.t_s[:samples],
        commands=episode.commands[:samples],
        observations=episode.observations[:samples],
    )


def test_cogging_takes_most_of_what_the_form_leaves(case):
    plant, quality, episodes = case
    guesses, taken = spatial_periods(plant, quality, 0, episodes)
    assert guesses
    assert taken > 0.3


@pytest.mark.parametrize("samples", [2, 3, 8])
def test_an_episode_too_short_for_a_span_adds_nothing(case, samples):
    plant, quality, episodes = case
    short = first(episodes[0], samples)
    alone, beside = (
        spatial_periods(plant, quality, 0, some) for some in (episodes[1:], [short, *episodes[1:]])
    )
    assert beside[1] == pytest.approx(alone[1], rel=0.2)


def test_short_episodes_alone_show_no_period(case):
    plant, quality, episodes = case
    assert spatial_periods(plant, quality, 0, [first(e, 4) for e in episodes]) == ([], 0.0)
