"""A picture of figures over time, whose points link to where each comes from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from markupsafe import Markup

from trueup.diagnose.number_text import short
from trueup_pages.drawing import Scale
from trueup_pages.drawing import ticks as linear_ticks
from trueup_pages.time_axis import seconds, ticks

WIDTH, HEIGHT = 720, 260
LEFT, RIGHT, TOP, BOTTOM = 64, 20, 14, 30
MOST_LINES = 6  # of a grid; more are hard to read


@dataclass(frozen=True, slots=True)
class Point:
    """A figure at a time: what stands beside it, the kind of its colour, what it is in words, and
    the page that it links to."""

    at: str
    value: float
    mark: str
    kind: str
    label: str
    page: str


def chart(points: Sequence[Point], label: str) -> Markup:
    """Draws positive figures over time, on a logarithmic axis; nothing where there is no point."""
    drawable = [p for p in points if p.value > 0.0]
    if not drawable:
        return Markup("")
    scale = Scale([p.value for p in drawable], HEIGHT - TOP - BOTTOM)
    times = [seconds(p.at) for p in drawable]
    first, last = min(times), max(times)
    margin = 0.06 * (last - first) or 1.0
    first, last = first - margin, last + margin

    def x(at_s: float) -> float:
        return LEFT + (at_s - first) / (last - first) * (WIDTH - LEFT - RIGHT)

    def y(value: float) -> float:
        return HEIGHT - BOTTOM - scale(value)

    body = [
        f'<line class="grid" x1="{x(at):.1f}" x2="{x(at):.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>'
        f'<text x="{x(at):.1f}" y="{HEIGHT - 10}" text-anchor="middle">{written}</text>'
        for at, written in ticks(first, last)
    ]
    body += [
        f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y(v):.1f}" y2="{y(v):.1f}"/>'
        f'<text x="{LEFT - 8}" y="{y(v) + 4:.1f}" text-anchor="end">{short(v)}</text>'
        for v in _round(scale)
    ]
    for p, at in zip(drawable, times, strict=True):
        body.append(
            f'<a href="{escape(p.page)}" aria-label="{escape(p.label)}"><title>{escape(p.label)}'
            f'</title><circle class="{p.kind}" cx="{x(at):.1f}" cy="{y(p.value):.1f}" r="6"/>'
            f'<text x="{x(at) + 9:.1f}" y="{y(p.value) + 4:.1f}">{escape(p.mark)}</text></a>'
        )
    return Markup(
        f'<svg class="curves" viewBox="0 0 {WIDTH} {HEIGHT}" role="group" '
        f'aria-label="{escape(label)}">{"".join(body)}</svg>'
    )


def _round(scale: Scale) -> list[float]:
    """Round values within a logarithmic scale: 1, 2 and 5 of each decade, the decades alone where
    those are many, and evenly spaced ones where it is narrow."""
    low, high = 10.0**scale.low, 10.0**scale.high
    decades = range(int(scale.low) - 1, int(scale.high) + 2)
    within = [
        [factor * 10.0**d for d in decades for factor in factors] for factors in ((1, 2, 5), (1,))
    ]
    fine, coarse = ([v for v in values if low <= v <= high] for values in within)
    if len(fine) <= 1:
        return linear_ticks(low, high)
    return fine if len(fine) <= MOST_LINES else coarse
