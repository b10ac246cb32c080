"""Curves over an axis that has a name and a unit, on linear or logarithmic scales."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from markupsafe import Markup

from trueup.diagnose.number_text import short

COLOURS = ("nominal", "corrected", "refitted", "good", "bad", "left", "bar", "ink")
WIDTH, HEIGHT = 620.0, 300.0
LEFT, RIGHT, TOP, BOTTOM = 64.0, 12.0, 22.0, 42.0
MARGIN = 0.04  # of a span, on both sides
TICKS = 5


@dataclass(frozen=True, slots=True)
class Curve:
    """One line: its name, a class of the stylesheet, and its points; a missing value breaks it."""

    name: str
    kind: str
    points: tuple[tuple[float, float | None], ...]
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis: what it shows, with its unit, and whether its scale is logarithmic."""

    label: str
    logarithmic: bool = False

    def place(self, value: float) -> float:
        """Where a value stands on the axis's scale."""
        return math.log10(value) if self.logarithmic else value

    def shows(self, value: float | None) -> bool:
        """Whether a value has a place."""
        return value is not None and math.isfinite(value) and (value > 0.0 or not self.logarithmic)


def colour(index: int) -> str:
    """The class of the line with this index."""
    return COLOURS[index % len(COLOURS)]


def curves(lines: Sequence[Curve], across: Axis, along: Axis, label: str) -> Markup:
    """Draws lines, each value clipped to what the axes show; empty if there is nothing to draw."""
    xs = [across.place(x) for c in lines for x, y in c.points if across.shows(x) and along.shows(y)]
    ys = [along.place(y) for c in lines for _, y in c.points if y is not None and along.shows(y)]
    if not xs or not ys:
        return Markup("")
    x_span, y_span = _span(xs), _span(ys)

    def at(x: float, y: float) -> tuple[float, float]:
        return (
            LEFT + (x - x_span[0]) / (x_span[1] - x_span[0]) * (WIDTH - LEFT - RIGHT),
            TOP + (y_span[1] - y) / (y_span[1] - y_span[0]) * (HEIGHT - TOP - BOTTOM),
        )

    drawn = []
    for value in _ticks(y_span, along):
        _, y = at(x_span[0], along.place(value))
        drawn.append(
            f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        )
        drawn.append(_text(LEFT - 6, y + 4, short(value), "end"))
    for value in _ticks(x_span, across):
        x, _ = at(across.place(value), y_span[0])
        drawn.append(
            f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>'
        )
        drawn.append(_text(x, HEIGHT - BOTTOM + 16, short(value), "middle"))
    for curve in lines:
        dashes = " dashed" if curve.dashed else ""
        for piece in _pieces(curve, across, along):
            points = [at(x, y) for x, y in piece]
            path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
            drawn.append(f'<polyline class="line {curve.kind}{dashes}" points="{path}"/>')
            if len(piece) < TICKS * TICKS and not curve.dashed:
                drawn += [
                    f'<circle class="{curve.kind}" cx="{x:.1f}" cy="{y:.1f}" r="3"/>'
                    for x, y in points
                ]
    drawn.append(_text(LEFT, TOP - 8, along.label))
    drawn.append(_text(WIDTH - RIGHT, HEIGHT - 6, across.label, "end"))
    return Markup(
        f'<svg class="curves" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="{escape(label)}">{"".join(drawn)}</svg>'
    )


def key(lines: Sequence[Curve]) -> Markup:
    """Draws what each line is."""
    seen = dict.fromkeys((c.name, c.kind, c.dashed) for c in lines)
    parts = [
        f'<span><svg class="swatch" viewBox="0 0 24 10" aria-hidden="true"><line class="line '
        f'{kind}{" dashed" if dashed else ""}" x1="0" x2="24" y1="5" y2="5"/></svg> '
        f"{escape(name)}</span>"
        for name, kind, dashed in seen
    ]
    return Markup(f'<div class="key">{"".join(parts)}</div>')


def _pieces(curve: Curve, across: Axis, along: Axis) -> list[list[tuple[float, float]]]:
    """The places of a line's points, broken where values are missing."""
    pieces: list[list[tuple[float, float]]] = [[]]
    for x, y in curve.points:
        if y is None or not (across.shows(x) and along.shows(y)):
            pieces.append([])
        else:
            pieces[-1].append((across.place(x), along.place(y)))
    return [p for p in pieces if p]


def _span(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    margin = MARGIN * (high - low) or 0.5 * abs(high) or 1.0
    return low - margin, high + margin


def _ticks(span: tuple[float, float], axis: Axis) -> list[float]:
    """Round values within a span."""
    low, high = span
    if axis.logarithmic:
        every = max(1, math.ceil((high - low) / TICKS))
        decades = [d for d in range(math.ceil(low), math.floor(high) + 1) if d % every == 0]
        if len(decades) > 1:
            return [10.0**d for d in decades]
        low, high = 10.0**low, 10.0**high
    step = 10.0 ** math.floor(math.log10((high - low) / TICKS))
    step *= next(m for m in (1, 2, 5, 10) if (high - low) / (m * step) <= TICKS)
    first = math.ceil(low / step)
    ticks = [round(k * step, 12) for k in range(first, math.floor(high / step) + 1)]
    return [t for t in ticks if axis.shows(t)]


def _text(x: float, y: float, words: str, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'
