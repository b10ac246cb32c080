"""Before and after as one SVG: what was measured, what each model predicted window by window, and by how much it missed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WIDTH, LEFT, RIGHT = 960, 76, 24
TOP_PANEL, BOTTOM_PANEL = (92, 250), (392, 170)  # (top, height)
TICKS = 5
INK, PALE, GRID = "#1f2933", "#7b8794", "#e4e7eb"
MEASURED, BEFORE, AFTER = "#1f2933", "#d9822b", "#137cbd"
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


@dataclass(frozen=True, slots=True)
class Trace:
    """One model's prediction at every sample `(samples,)`, and its RMS error in words."""

    name: str
    values: Array
    rms: str
    colour: str


def before_and_after(title: str, subtitle: str, t_s: Array, measured: Array, traces: Sequence[Trace], starts_s: Array, unit: str) -> str:
    """The picture. Rollouts start anew at `starts_s` [s]; errors are drawn in thousandths of `unit`."""
    span = _nice(float(t_s[0]), float(t_s[-1]))
    upper = _Panel(*TOP_PANEL, span, _nice(*_range([measured, *(t.values for t in traces)])))
    lower = _Panel(*BOTTOM_PANEL, span, _nice(*_range([1e3 * (t.values - measured) for t in traces])))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} 640" font-family="system-ui, sans-serif" font-size="13" '
        f'role="img" aria-label="{escape(title)}">',
        f'<rect width="{WIDTH}" height="640" fill="#fff"/>',
        _text(LEFT, 34, title, INK, size=19, weight=600),
        _text(LEFT, 56, subtitle, PALE),
        _legend(traces),
        upper.frame(f"position [{unit}]"),
        *(upper.line(t_s, t.values, t.colour, breaks=starts_s) for t in traces),
        upper.line(t_s, measured, MEASURED, width=1.2, dash="2 3"),
        lower.frame(f"prediction − measured [m{unit}]", times=True),
        *(lower.line(t_s, 1e3 * (t.values - measured), t.colour, breaks=starts_s) for t in traces),
        _text(
            WIDTH / 2,
            614,
            "time [s]; each rollout runs on the issued commands alone until the next tick below the axis",
            PALE,
            anchor="middle",
        ),
        *(f'<path d="M{lower.x(s):.1f} {lower.bottom}v6" stroke="{INK}"/>' for s in starts_s),
        "</svg>",
    ]
    return "\n".join(parts)


class _Panel:
    """A pair of axes."""

    def __init__(self, top: float, height: float, x: Array, y: Array) -> None:
        self.top, self.bottom, self._x, self._y = top, top + height, x, y

    def x(self, value: float) -> float:
        return float(LEFT + (value - self._x[0]) / (self._x[-1] - self._x[0]) * (WIDTH - LEFT - RIGHT))

    def y(self, value: float) -> float:
        return float(self.bottom - (value - self._y[0]) / (self._y[-1] - self._y[0]) * (self.bottom - self.top))

    def frame(self, label: str, *, times: bool = False) -> str:
        rows = [
            f'<path d="M{LEFT} {self.y(v):.1f}H{WIDTH - RIGHT}" stroke="{GRID}"/>'
            + _text(LEFT - 10, self.y(v) + 4, f"{v:g}", PALE, anchor="end")
            for v in self._y
        ]
        columns = [_text(self.x(v), self.bottom + 20, f"{v:g}", PALE, anchor="middle") for v in self._x] if times else []
        return "".join([*rows, *columns, _text(LEFT, self.top - 10, label, INK)])

    def line(self, t: Array, values: Array, colour: str, *, width: float = 1.8, dash: str = "", breaks: Array | None = None) -> str:
        """A line, broken where a new rollout starts, and thinned to about one point a pixel."""
        cuts = np.searchsorted(t, [] if breaks is None else breaks)
        pieces = [p for p in np.split(np.arange(len(t)), cuts) if len(p) > 1]
        every = max(1, len(t) // WIDTH)
        d = "".join("M" + "L".join(f"{self.x(t[i]):.1f} {self.y(values[i]):.1f}" for i in [*p[::every], p[-1]]) for p in pieces)
        return (
            f'<path d="{d}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"'
            + (f' stroke-dasharray="{dash}"' if dash else "")
            + "/>"
        )


def _legend(traces: Sequence[Trace]) -> str:
    entries = [("measured", MEASURED), *((f"{t.name} ({t.rms})", t.colour) for t in traces)]
    x, parts = float(WIDTH - RIGHT), []
    for name, colour in reversed(entries):
        x -= 7.2 * len(name) + 34
        parts.append(f'<path d="M{x:.0f} 80h18" stroke="{colour}" stroke-width="3"/>' + _text(x + 24, 84, name, INK))
    return "".join(parts)


def _range(values: Sequence[Array]) -> tuple[float, float]:
    finite = np.concatenate([v[np.isfinite(v)] for v in values])
    return float(finite.min()), float(finite.max())


def _nice(low: float, high: float) -> Array:
    """Round ticks that enclose a range."""
    span = max(high - low, 1e-12) / TICKS
    power = 10.0 ** np.floor(np.log10(span))
    step = power * next(s for s in STEPS if s * power >= span)
    return np.asarray(np.round(np.arange(np.floor(low / step), np.ceil(high / step) + 1) * step, 12))


def _text(x: float, y: float, text: str, colour: str, *, size: int = 13, weight: int = 400, anchor: str = "start") -> str:
    look = f'fill="{colour}" font-size="{size}" font-weight="{weight}" text-anchor="{anchor}"'
    return f'<text x="{x:.1f}" y="{y:.1f}" {look}>{escape(text)}</text>'
