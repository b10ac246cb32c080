"""Axes, lines and text as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WIDTH, LEFT, RIGHT = 960, 76, 24
TICKS = 5
INK, PALE, GRID = "#1f2933", "#7b8794", "#e4e7eb"
SERIES = ("#137cbd", "#d9822b", "#0d8050", "#8f398f", "#c23030", "#5c7080")
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


def sheet(title: str, subtitle: str, height: int, parts: Sequence[str]) -> str:
    """Returns a picture with its title."""
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
            'font-family="system-ui, sans-serif" font-size="13" '
            f'role="img" aria-label="{escape(title)}">',
            f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
            text(LEFT, 34, title, INK, size=19, weight=600),
            text(LEFT, 56, subtitle, PALE),
            *parts,
            "</svg>",
        ]
    )


class Panel:
    """A pair of axes."""

    def __init__(self, top: float, height: float, x: Array, y: Array) -> None:
        self.top, self.bottom, self._x, self._y = top, top + height, x, y

    def x(self, value: float) -> float:
        """Returns the horizontal position of a value."""
        return float(
            LEFT + (value - self._x[0]) / (self._x[-1] - self._x[0]) * (WIDTH - LEFT - RIGHT)
        )

    def y(self, value: float) -> float:
        """Returns the vertical position of a value."""
        return float(
            self.bottom
            - (value - self._y[0]) / (self._y[-1] - self._y[0]) * (self.bottom - self.top)
        )

    def frame(self, label: str, *, times: bool = False) -> str:
        """Returns the grid with its numbers and its label."""
        rows = [
            f'<path d="M{LEFT} {self.y(v):.1f}H{WIDTH - RIGHT}" stroke="{GRID}"/>'
            + text(LEFT - 10, self.y(v) + 4, f"{v:g}", PALE, anchor="end")
            for v in self._y
        ]
        columns = (
            [text(self.x(v), self.bottom + 20, f"{v:g}", PALE, anchor="middle") for v in self._x]
            if times
            else []
        )
        return "".join([*rows, *columns, text(LEFT, self.top - 10, label, INK)])

    def line(
        self,
        t: Array,
        values: Array,
        colour: str,
        *,
        width: float = 1.8,
        dash: str = "",
        breaks: Array | None = None,
    ) -> str:
        """Returns a line, broken where a rollout starts, and thinned to about one point a pixel."""
        cuts = np.searchsorted(t, [] if breaks is None else breaks)
        pieces = [p for p in np.split(np.arange(len(t)), cuts) if len(p) > 1]
        every = max(1, len(t) // WIDTH)
        d = "".join(
            "M"
            + "L".join(f"{self.x(t[i]):.1f} {self.y(values[i]):.1f}" for i in [*p[::every], p[-1]])
            for p in pieces
        )
        return (
            (
                f'<path d="{d}" fill="none" stroke="{colour}" stroke-width="{width}" '
                'stroke-linejoin="round"'
            )
            + (f' stroke-dasharray="{dash}"' if dash else "")
            + "/>"
        )


def legend(entries: Sequence[tuple[str, str]], y: float = 84) -> str:
    """Returns names with their colours, in one row that ends at the right."""
    x, parts = float(WIDTH - RIGHT), []
    for name, colour in reversed(entries):
        x -= 7.2 * len(name) + 34
        parts.append(
            f'<path d="M{x:.0f} {y - 4:g}h18" stroke="{colour}" stroke-width="3"/>'
            + text(x + 24, y, name, INK)
        )
    return "".join(parts)


def range_of(values: Sequence[Array]) -> tuple[float, float]:
    """Returns the least and the largest finite value."""
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    return float(finite.min()), float(finite.max())


def nice(low: float, high: float) -> Array:
    """Returns round ticks that enclose a range."""
    span = max(high - low, 1e-12) / TICKS
    power = 10.0 ** np.floor(np.log10(span))
    step = power * next(s for s in STEPS if s * power >= span)
    return np.asarray(
        np.round(np.arange(np.floor(low / step), np.ceil(high / step) + 1) * step, 12)
    )


def text(
    x: float,
    y: float,
    words: str,
    colour: str,
    *,
    size: int = 13,
    weight: int = 400,
    anchor: str = "start",
) -> str:
    """Returns text at a position."""
    look = f'fill="{colour}" font-size="{size}" font-weight="{weight}" text-anchor="{anchor}"'
    return f'<text x="{x:.1f}" y="{y:.1f}" {look}>{escape(words)}</text>'
