"""Many decisions are recomputed here while that is short, and by several processes where it is not;
the answers and their order are the same."""

import os

import pytest

from trueup_cli import replay

DECISIONS = [f"{i:064x}" for i in range(6)]


def recomputed(url, decision):
    """How a decision differs, and who says so, in place of what asks a service."""
    return [url, decision, str(os.getpid())]


@pytest.fixture
def replayed(monkeypatch):
    def of(starting_s, at_once):
        monkeypatch.setattr(replay, "replay_differences", recomputed)
        monkeypatch.setattr(replay, "STARTING_S", starting_s)
        monkeypatch.setattr(replay, "cores", lambda: at_once)
        pairs = list(replay.replayed("http://here", DECISIONS))
        assert [decision for decision, _ in pairs] == DECISIONS
        assert [answer[:2] for _, answer in pairs] == [["http://here", d] for d in DECISIONS]
        return [int(answer[2]) for _, answer in pairs]

    return of


def test_what_is_short_is_recomputed_here(replayed):
    assert set(replayed(3.0, 2)) == {os.getpid()}


def test_what_is_long_is_recomputed_by_others_at_once(replayed):
    by = replayed(0.0, 2)
    assert by[: replay.WARM] == [os.getpid()] * replay.WARM
    assert os.getpid() not in by[replay.WARM :]


def test_where_there_is_one_core_it_is_recomputed_here(replayed):
    assert set(replayed(0.0, 1)) == {os.getpid()}
