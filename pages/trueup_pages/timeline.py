"""The timeline of a plant: a lane for each kind of event, whose marks link to their pages.

Marks that would lie on each other are one with a count, which leads to that stretch of time alone;
where they cannot be told apart, to the list below.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from typing import Any
from urllib.parse import urlencode

from markupsafe import Markup

from trueup_pages.time_axis import seconds, ticks

WIDTH, LEFT, RIGHT, LANE, TOP, BOTTOM = 980, 110, 20, 34, 10, 28
LANES = ("episodes", "alarms", "diagnoses", "decisions", "serving")
APART = 14.0  # of the middles of two marks that can both be hit
WIDEST = 60.0  # of a mark that stands for several
FIRST_S, LAST_S = 0.0, 253_402_300_799.0  # 1970 to 9999: what an address can name
SHORTEST_S = 1.0  # of a stretch that can be looked at closer
LIST = "#entries"  # where the page lists what the timeline shows
HERE = "#when"


@dataclass(frozen=True, slots=True)
class Mark:
    """An event: its time, lane, kind and label, and the page that it links to."""

    at: str
    lane: str
    kind: str
    label: str
    page: str = ""


@dataclass(frozen=True, slots=True)
class Placed:
    """A mark, where it is drawn, and its time [s since 1970]."""

    mark: Mark
    x: float
    at_s: float


def timeline(plant: str, entries: Sequence[Any], window: tuple[str, str] | None = None) -> Markup:
    """Draws entries of the log (`at`, `kind`, `subject`, `facts`), which come with the newest
    first: from the first of them to the last, or over a window of time."""
    marks = [mark for e in reversed(entries) if (mark := _mark(plant, e)) is not None]
    height = TOP + LANE * len(LANES) + BOTTOM
    body = "".join(_lane(name, _height(name)) for name in LANES)
    if marks or window is not None:
        first, last = (
            (seconds(window[0]), seconds(window[1]))
            if window is not None
            else (seconds(marks[0].at), seconds(marks[-1].at))
        )
        span = max(last - first, 1.0)

        def place(at_s: float) -> float:
            return LEFT + 10 + (at_s - first) / span * (WIDTH - LEFT - RIGHT - 10)

        body += "".join(
            f'<line class="grid" x1="{place(at):.1f}" x2="{place(at):.1f}" y1="{TOP}" '
            f'y2="{height - BOTTOM}"/><text x="{place(at):.1f}" y="{height - 8}" '
            f'text-anchor="middle">{written}</text>'
            for at, written in ticks(first, first + span)
        )
        placed = [Placed(m, place(at), at) for m in marks for at in [seconds(m.at)]]
        body += "".join(
            _drawn(group[0]) if len(group) == 1 else _cluster(plant, group)
            for lane in LANES
            for group in _groups([p for p in placed if p.mark.lane == lane])
        )
    named = 'role="group" aria-label="what happened, by kind and time"'
    return Markup(f'<svg class="timeline" viewBox="0 0 {WIDTH} {height}" {named}>{body}</svg>')


def zooms(plant: str, window: tuple[str, str] | None, shown: Sequence[Any]) -> list[dict[str, str]]:
    """The links beside the timeline: to what is earlier and later, closer and further away. The
    entries that are `shown` come with the newest first."""
    if window is None and not shown:
        return []
    first, last = (
        (seconds(window[0]), seconds(window[1]))
        if window is not None
        else (seconds(shown[-1].at), seconds(shown[0].at))
    )
    middle, half = (first + last) / 2.0, max(last - first, SHORTEST_S) / 2.0
    steps = [
        ("Earlier", middle - 3.0 * half, middle - half),
        ("Later", middle + half, middle + 3.0 * half),
        ("Closer", middle - half / 2.0, middle + half / 2.0),
        ("Further", middle - 2.0 * half, middle + 2.0 * half),
    ]
    links = [
        {"label": label, "page": _page(plant, a, b)}
        for label, a, b in steps
        if a < LAST_S and b > FIRST_S and b - a >= SHORTEST_S / 2.0
    ]
    return [*links, {"label": "Newest", "page": f"/plants/{plant}{HERE}"}]


def page_of(plant: str, e: Any) -> str:
    """The page of what an entry of the log is about, empty where there is none."""
    mark = _mark(plant, e)
    return "" if mark is None else mark.page


def _page(plant: str, first_s: float, last_s: float) -> str:
    since, until = (_text(at) for at in (first_s, last_s))
    return f"/plants/{plant}?{urlencode({'since': since, 'until': until})}{HERE}"


def _text(at_s: float) -> str:
    """A time as the registry writes it."""
    return datetime.fromtimestamp(min(max(at_s, FIRST_S), LAST_S), UTC).strftime(
        "%Y-%m-%dT%H:%M:%S.%fZ"
    )


def _groups(placed: Sequence[Placed]) -> Iterator[list[Placed]]:
    """Yields the marks of one lane, those together that lie on each other."""
    group: list[Placed] = []
    for one in placed:
        if group and (one.x - group[-1].x > APART or one.x - group[0].x > WIDEST):
            yield group
            group = []
        group.append(one)
    if group:
        yield group


def _height(lane: str) -> int:
    return TOP + LANE * LANES.index(lane) + LANE // 2


def _lane(name: str, y: int) -> str:
    return (
        f'<text x="0" y="{y + 4}">{name}</text><line class="grid" x1="{LEFT}" '
        f'x2="{WIDTH - 8}" y1="{y}" y2="{y}"/>'
    )


def _drawn(placed: Placed) -> str:
    mark, x, y = placed.mark, placed.x, _height(placed.mark.lane)
    shape = (
        f'd="M{x - 6:.1f} {y + 6}h12l-6 -12z"'
        if mark.lane == "alarms"
        else f'd="M{x - 6:.1f} {y}a6 6 0 1 0 12 0a6 6 0 1 0 -12 0z"'
    )
    return _linked(
        f"{mark.label}, {_minute(mark.at)}",
        mark.page or LIST,
        f'<path class="mark-{mark.kind}" {shape}/>',
    )


def _cluster(plant: str, group: Sequence[Placed]) -> str:
    """Draws marks that lie on each other as one, with their number."""
    first, last, y = group[0], group[-1], _height(group[0].mark.lane)
    kinds = {p.mark.kind for p in group}
    kind = kinds.pop() if len(kinds) == 1 else "several"
    span = last.at_s - first.at_s
    page = (
        LIST if span < SHORTEST_S else _page(plant, first.at_s - span / 20, last.at_s + span / 20)
    )
    width = max(last.x - first.x + 12.0, 10.0 + 7.0 * len(str(len(group))))
    middle = (first.x + last.x) / 2.0
    drawn = (
        f'<rect class="mark-{kind}" x="{middle - width / 2:.1f}" y="{y - 8}" width="{width:.1f}" '
        f'height="16" rx="8"/><text class="count" x="{middle:.1f}" y="{y + 4}" '
        f'text-anchor="middle">{len(group)}</text>'
    )
    label = f"{len(group)} {first.mark.lane}, {_minute(first.mark.at)} to {_minute(last.mark.at)}"
    return _linked(label, page, drawn)


def _linked(label: str, page: str, drawn: str) -> str:
    return (
        f'<a href="{escape(page)}" aria-label="{escape(label)}"><title>{escape(label)}</title>'
        f"{drawn}</a>"
    )


def _minute(at: str) -> str:
    return at[:16].replace("T", " ")


def _mark(plant: str, e: Any) -> Mark | None:
    """Returns an entry as a mark; None if its kind has no lane."""
    here = f"/plants/{plant}"
    if e.kind == "episode:ingested":
        name = str(e.facts.get("name") or e.subject[:12])
        return Mark(e.at, "episodes", "episode", f"episode {name}", f"{here}/episodes/{e.subject}")
    if e.kind in ("alarm:raised", "alarm:closed"):
        return Mark(
            e.at,
            "alarms",
            "alarm" if e.kind == "alarm:raised" else "episode",
            e.kind.replace(":", " "),
            f"{here}/monitor",
        )
    if e.kind == "job:finished" and e.facts.get("kind") == "diagnose":
        return Mark(
            e.at,
            "diagnoses",
            "diagnosis",
            f"diagnosis {e.facts.get('state')}",
            f"{here}/diagnoses/{e.subject}",
        )
    if e.kind == "decision:made":
        verdict = "accepted" if e.facts.get("decision", {}).get("accepted") else "rejected"
        return Mark(e.at, "decisions", verdict, verdict, f"{here}/decisions/{e.subject}")
    if e.kind in ("pointer:moved", "plant:registered"):
        moved = str(e.facts.get("move", "registered")).replace("_", " ")
        label = f"{moved}, generation {e.facts.get('generation', 1)}"
        page = f"{here}/versions" + (f"?q={e.subject}" if e.kind == "pointer:moved" else "/1")
        return Mark(e.at, "serving", "move", label, page)
    return None
