"""The timeline of a plant: every event is on it, can be told what and when it was, and reached."""

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from html import unescape
from urllib.parse import parse_qs, urlsplit

import pytest

from trueup_pages.time_axis import ticks
from trueup_pages.timeline import timeline, zooms

START = datetime(2026, 3, 1, 12, tzinfo=UTC)
LINK = re.compile(r'<a href="([^"]*)" aria-label="([^"]*)">')


@dataclass(frozen=True)
class Entry:
    at: str
    kind: str
    subject: str
    facts: dict = field(default_factory=dict)


def entry(after_s, kind="episode:ingested", subject="a" * 64, **facts):
    at = (START + timedelta(seconds=after_s)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    return Entry(at, kind, subject, facts)


def links(drawn):
    return [(unescape(page), unescape(label)) for page, label in LINK.findall(str(drawn))]


def within(entries, page):
    """What a link shows: the entries of its stretch of time, and that."""
    asked = parse_qs(urlsplit(page).query)
    window = asked["since"][0], asked["until"][0]
    return [e for e in entries if window[0] <= e.at <= window[1]], window


def reached(entries, drawn):
    """The pages of episodes that links lead to, followed into every stretch of time."""
    pages = set()
    for page, _ in links(drawn):
        if "since=" in page:
            inside, window = within(entries, page)
            assert len(inside) < len(entries)
            pages |= reached(inside, timeline("p", inside, window))
        else:
            pages.add(page)
    return pages


def test_every_mark_can_be_reached_by_going_closer():
    bursts = [3600 * burst + 2 * i for burst in range(5) for i in range(40)]
    entries = [entry(s, subject=f"{i:064x}") for i, s in enumerate(bursts)][::-1]
    pages = reached(entries, timeline("p", entries))
    assert pages == {f"/plants/p/episodes/{e.subject}" for e in entries}


def test_events_that_come_evenly_are_reached_too():
    entries = [entry(600 * i, subject=f"{i:064x}") for i in range(300)][::-1]
    assert len(reached(entries, timeline("p", entries))) == 300


@pytest.mark.parametrize("window", [("2026-01-01", "9999-12-31"), ("1970-01-01", "1970-01-02")])
def test_stretches_end_where_addresses_do(window):
    both = tuple(f"{day}T00:00:00.000000Z" for day in window)
    assert all("since=" in z["page"] or z["label"] == "Newest" for z in zooms("p", both, []))


def test_a_moment_is_looked_at_no_closer():
    window = (entry(0).at, entry(0.4).at)
    assert "Closer" in [z["label"] for z in zooms("p", window, [])]
    assert all(
        parse_qs(urlsplit(z["page"]).query)["since"] < parse_qs(urlsplit(z["page"]).query)["until"]
        for z in zooms("p", window, [])
        if z["label"] != "Newest"
    )


def test_marks_of_one_moment_lead_to_the_list():
    entries = [entry(0.1 * i, subject=f"{i:064x}") for i in range(5)]
    drawn = links(timeline("p", [entry(3600), *entries[::-1]]))
    assert drawn[0] == ("#entries", "5 episodes, 2026-03-01 12:00 to 2026-03-01 12:00")


def test_a_mark_says_what_and_when_and_leads_there():
    raised = entry(0, "alarm:raised", "f" * 32)
    decided = entry(7200, "decision:made", "d" * 64, decision={"accepted": True})
    named = entry(3600, name="<b>run</b>")
    assert links(timeline("p", [decided, named, raised])) == [
        (f"/plants/p/episodes/{named.subject}", "episode <b>run</b>, 2026-03-01 13:00"),
        ("/plants/p/monitor", "alarm raised, 2026-03-01 12:00"),
        (f"/plants/p/decisions/{decided.subject}", "accepted, 2026-03-01 14:00"),
    ]


def test_stretches_lead_earlier_later_closer_and_further():
    entries = [entry(3600), entry(0)]
    steps = {link["label"]: link["page"] for link in zooms("p", None, entries)}
    assert list(steps) == ["Earlier", "Later", "Closer", "Further", "Newest"]
    inside, window = within([entry(1800), *entries], steps["Closer"])
    assert [e.at for e in inside] == [entry(1800).at]
    assert window == (entry(900).at, entry(2700).at)
    assert zooms("p", None, []) == []


@pytest.mark.parametrize("span_s", [1.0, 7.0, 90.0, 4e3, 86400.0, 9e6, 4e8, 3e9, 2e11])
def test_ticks_are_round_moments_and_few(span_s):
    first = START.timestamp() + 0.3
    moments = ticks(first, first + span_s)
    assert 1 <= len(moments) <= 8
    assert all(first <= at <= first + span_s for at, _ in moments)
    assert len({written for _, written in moments}) == len(moments)


def test_an_empty_timeline_is_drawn():
    assert links(timeline("p", [])) == []
    window = (entry(0).at, entry(60).at)
    assert "12:00:30" in timeline("p", [], window)
