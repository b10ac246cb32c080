"""The timeline of a plant: a lane for each kind of event, whose marks link to their pages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from html import escape
from typing import Any

from markupsafe import Markup

WIDTH, LEFT, LANE, TOP = 980, 110, 34, 10
LANES = ("episodes", "alarms", "diagnoses", "decisions", "serving")


@dataclass(frozen=True, slots=True)
class Mark:
    """An event: its time, lane, kind and label, and the page that it links to."""

    at: str
    lane: str
    kind: str
    label: str
    page: str = ""


def timeline(plant: str, entries: Sequence[Any]) -> Markup:
    """Draws entries of the log (`at`, `kind`, `subject`, `facts`), the newest to the right.

    The entries come with the newest first.
    """
    marks = [mark for e in reversed(entries) if (mark := _mark(plant, e)) is not None]
    height = TOP + LANE * len(LANES) + 24
    body = "".join(_lane(name, _height(name)) for name in LANES)
    if marks:
        seconds = [datetime.fromisoformat(mark.at).timestamp() for mark in marks]
        span = max(seconds[-1] - seconds[0], 1.0)
        body += "".join(
            _drawn(m, LEFT + 10 + (s - seconds[0]) / span * (WIDTH - LEFT - 30))
            for m, s in zip(marks, seconds, strict=True)
        )
        body += f'<text x="{LEFT}" y="{height - 6}">{_minute(marks[0].at)}</text>'
        body += (
            f'<text x="{WIDTH - 8}" y="{height - 6}" '
            f'text-anchor="end">{_minute(marks[-1].at)}</text>'
        )
    named = 'role="group" aria-label="what happened, by kind and time"'
    return Markup(f'<svg class="timeline" viewBox="0 0 {WIDTH} {height}" {named}>{body}</svg>')


def _height(lane: str) -> int:
    return TOP + LANE * LANES.index(lane) + LANE // 2


def _lane(name: str, y: int) -> str:
    return (
        f'<text x="0" y="{y + 4}">{name}</text><line class="grid" x1="{LEFT}" '
        f'x2="{WIDTH - 8}" y1="{y}" y2="{y}"/>'
    )


def _drawn(mark: Mark, x: float) -> str:
    y = _height(mark.lane)
    shape = (
        f'd="M{x - 6:.1f} {y + 6}h12l-6 -12z"'
        if mark.lane == "alarms"
        else f'd="M{x - 6:.1f} {y}a6 6 0 1 0 12 0a6 6 0 1 0 -12 0z"'
    )
    drawn = (
        f"<title>{escape(mark.label)}, {_minute(mark.at)}</title><path "
        f'class="mark-{mark.kind}" {shape}/>'
    )
    return (
        f'<a href="{escape(mark.page)}" aria-label="{escape(mark.label)}">{drawn}</a>'
        if mark.page
        else f"<g>{drawn}</g>"
    )


def _minute(at: str) -> str:
    return escape(at[:16].replace("T", " "))


def _mark(plant: str, e: Any) -> Mark | None:
    """Returns an entry as a mark; None if its kind has no lane."""
    here = f"/plants/{plant}"
    if e.kind == "episode:ingested":
        return Mark(
            e.at, "episodes", "episode", f"episode {e.subject[:12]}", f"{here}/episodes/{e.subject}"
        )
    if e.kind in ("alarm:raised", "alarm:closed"):
        return Mark(
            e.at,
            "alarms",
            "alarm" if e.kind == "alarm:raised" else "episode",
            e.kind.replace(":", " "),
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
        return Mark(e.at, "serving", "move", f"{moved}, generation {e.facts.get('generation', 1)}")
    return None
