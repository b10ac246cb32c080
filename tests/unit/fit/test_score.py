"""What of an episode no window scores is said, with the reason."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded_twice as recorded
from trueup.errors import NotAnEpisode
from trueup.fit.score import EVERY, FIRST, Scoring, left_out, scored_windows


@pytest.fixture(scope="module", params=[True, False], ids=["velocity", "no velocity"])
def seen(request):
    plant, episodes, _ = recorded("A1", [], 3, velocity=request.param)
    return plant, episodes[0], request.param


@pytest.mark.parametrize("windows", [EVERY, FIRST])
def test_what_is_left_out_and_what_is_scored_are_the_whole_episode(seen, windows):
    plant, episode, knows_velocity = seen
    scoring = Scoring(1.0, windows)
    cut, rest = scored_windows(plant, episode, scoring), left_out(plant, episode, scoring)
    begin, end = episode.t_s[cut.first[0]], episode.t_s[cut.first[-1] + cut.lengths[-1] - 1]
    assert bool(rest and rest[0].why.startswith("the velocity")) is not knows_velocity
    assert max((s.to_s for s in rest if s.from_s == 0.0), default=0.0) == begin
    after = [s for s in rest if s.from_s > begin]
    assert end == (episode.t_s[-1] if windows == EVERY else after[0].from_s)
    assert [s.to_s for s in after] == ([] if windows == EVERY else [episode.t_s[-1]])


def test_a_sample_alone_behind_a_gap_is_left_out_and_one_that_ends_a_window_is_not(seen):
    plant, episode, _ = seen
    begin = scored_windows(plant, episode, Scoring(1.0, EVERY)).first[0]
    last = int(np.searchsorted(episode.t_s, episode.t_s[begin] + 2.0))
    part = replace(episode.part(0, last + 1), digest="part")
    before = left_out(plant, part, Scoring(1.0, EVERY))
    assert not any(s.why.startswith("a window of one sample") for s in before)
    t_s = part.t_s.copy()
    t_s[-1] += 0.3
    behind = left_out(plant, replace(part, t_s=t_s), Scoring(1.0, EVERY))
    assert behind[-1].why.startswith("a window of one sample")


def test_an_episode_of_which_nothing_is_scored_is_refused(seen):
    plant, episode, _ = seen
    with pytest.raises(NotAnEpisode):
        left_out(plant, episode, Scoring(1e-9, EVERY))
