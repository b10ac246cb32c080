"""A batch of telemetry becomes an episode, or is refused with the rule that it breaks."""

import io
from contextlib import suppress

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.made import plant_document
from trueup.episode.mcap import read_episode
from trueup.episode.telemetry import telemetry_to_mcap
from trueup.errors import NotAnEpisode
from trueup.model.plant import Plant

LAYOUT = Plant.from_document(plant_document()).layout


def episode_of(start_ns, t_s):
    n = len(t_s)
    columns = {"observations": {"q": [0.0] * n, "v": [0.0] * n}, "commands": {"u": [0.0] * n}}
    out = io.BytesIO()
    telemetry_to_mcap(orjson.dumps({"start_ns": str(start_ns), "t_s": t_s, **columns}), LAYOUT, out)
    return read_episode(out.getvalue(), LAYOUT)


def test_times_count_from_the_start():
    assert episode_of(10**18, [0.0, 0.02, 0.04]).t_s == pytest.approx([0.0, 0.02, 0.04])
    assert episode_of(10**18, [-0.5, 1.5]).t_s == pytest.approx([0.0, 2.0])


@pytest.mark.parametrize(
    ("start_ns", "t_s"),
    [
        (0, [0.0]),
        (0, [0.0, 0.0]),
        (0, [0.1, 0.0]),
        (0, [-1.0, 0.0]),
        (10**18, [0.0, 1e300]),
        (10**18, [-1e300, 0.0]),
        (10**18, [-1.7e308, 1.7e308]),
        (2**62, [0.0, 1.0]),
        (0, [0.0, 2e9]),
    ],
)
def test_times_that_no_clock_shows_are_refused(start_ns, t_s):
    with pytest.raises(NotAnEpisode) as refused:
        episode_of(start_ns, t_s)
    assert refused.value.facts["rule"] == "t_s"


@given(
    st.integers(0, 2**62),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=4),
)
def test_whatever_the_times_are_it_is_an_episode_or_refused(start_ns, t_s):
    with suppress(NotAnEpisode):
        assert (episode_of(start_ns, t_s).t_s >= 0.0).all()
