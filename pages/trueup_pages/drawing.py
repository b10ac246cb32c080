"""Pictures as SVG that take their colours from the page, in light and in dark.

Every picture says in `aria-label` what it shows, and has no style of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from markupsafe import Markup

from trueup.diagnose.number_text import percent, short, unit
from trueup.diagnose.summary_text import NEW_NUMBERS, NOISE, SAME_NUMBERS, UNEXPLAINED

LEVELS = 11  # colours of a map; odd, so that the middle one is zero
LEFT, BOTTOM, CELL_AREA = 66, 36, (300, 200)
PLOT, ERROR = (960, 230), (960, 120)
MOST_TICKS = 5.0
TINY = 1e-9  # of a step: a range that ends on a tick has it
HATCH = 9.0  # pixels from one stroke to the next
SPARK = (120, 26)
Pairs = Sequence[tuple[float, float | None]]


def _svg(width: float, height: float, label: str, body: str, kind: str = "") -> Markup:
    named = f" class={kind}" if kind else ""
    return Markup(
        f'<svg{named} viewBox="0 0 {width:g} {height:g}" role="img" '
        f'aria-label="{escape(label)}">{body}</svg>'
    )


def _text(x: float, y: float, words: str, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def _runs(
    points: Pairs,
    across: tuple[float, float],
    along: tuple[float, float],
    box: tuple[float, float, float, float],
) -> list[str]:
    """Returns a line's points in a box, broken where numbers are missing."""
    (x0, x1), (y0, y1), (left, top, width, height) = across, along, box
    pieces: list[list[str]] = [[]]
    for x, y in points:
        if y is None or not math.isfinite(y):
            if pieces[-1]:
                pieces.append([])
            continue
        held = min(max(y, y0), y1)
        distance = left + (x - x0) / (x1 - x0) * width
        depth = top + (y1 - held) / (y1 - y0) * height
        pieces[-1].append(f"{distance:.1f},{depth:.1f}")
    return [" ".join(p) for p in pieces if p]


def span_of(values: Sequence[float | None]) -> tuple[float, float]:
    """Returns the range of some values with a margin; (-1, 1) if none is finite."""
    fine = sorted(v for v in values if v is not None and math.isfinite(v))
    if not fine:
        return -1.0, 1.0
    low, high = fine[len(fine) // 500], fine[-1 - len(fine) // 500]
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def lines(
    t_s: Sequence[float],
    series: Mapping[str, Sequence[float | None]],
    label: str,
    size: tuple[int, int] = PLOT,
) -> Markup:
    """Draws lines over time [s]. The names in `series` are also the lines' classes."""
    width, height = size
    box = (LEFT, 8.0, width - LEFT - 8.0, height - 34.0)
    across = (t_s[0], t_s[-1]) if t_s[-1] > t_s[0] else (t_s[0], t_s[0] + 1.0)
    along = span_of([v for values in series.values() for v in values])
    drawn = []
    for part in (0.0, 0.5, 1.0):
        value, y = along[0] + part * (along[1] - along[0]), box[1] + (1.0 - part) * box[3]
        drawn.append(
            f'<line class="grid" x1="{LEFT}" x2="{width - 8}" y1="{y:.1f}" '
            f'y2="{y:.1f}"/>{_text(LEFT - 6, y + 4, short(value), "end")}'
        )
    for name, values in series.items():
        pieces = _runs(list(zip(t_s, values, strict=True)), across, along, box)
        drawn += [f'<polyline class="line {escape(name)}" points="{piece}"/>' for piece in pieces]
    drawn += [
        _text(LEFT, height - 8, f"{across[0]:.3g} s"),
        _text(width - 8, height - 8, f"{across[1]:.4g} s", "end"),
    ]
    return _svg(width, height, label, "".join(drawn))


def recording(recordings: Mapping[str, Any], channel: Mapping[str, Any], every: int) -> Markup:
    """Draws a channel of the first recording without a script, with one of `every` points."""
    drawn = {"measured": channel["measured"][::every]} | {
        m["kind"]: channel[m["key"]][::every] for m in recordings["models"]
    }
    words = ", ".join(m["label"] for m in recordings["models"])
    return lines(
        recordings["episodes"][0]["t_s"][::every],
        drawn,
        f"{channel['name']} over time: measured, {words}",
    )


def ticks(low: float, high: float) -> list[float]:
    """Returns round numbers within a range, two to five of them."""
    if not high > low:
        return [low]
    step = 10.0 ** math.floor(math.log10(high - low))
    step *= next((f for f in (0.2, 0.5, 1.0) if (high - low) / (f * step) <= MOST_TICKS), 1.0)
    first = math.ceil(low / step - TINY)
    return [round(i * step, 12) for i in range(first, math.floor(high / step + TINY) + 1)]


def _part(value: float, edges: Sequence[float]) -> float:
    return (value - edges[0]) / (edges[-1] - edges[0]) if edges[-1] > edges[0] else 0.5


def _hatched(x: float, y: float, width: float, height: float) -> str:
    """Draws a box in which there is nothing: what is known is drawn over it."""
    strokes = []
    for i in range(1, round((width + height) / HATCH)):
        along = i * HATCH
        x0, y0 = min(along, width), max(along - width, 0.0)
        x1, y1 = max(along - height, 0.0), min(along, height)
        strokes.append(f"M{x + x0:.0f} {y + y0:.0f}L{x + x1:.0f} {y + y1:.0f}")
    box = f'<rect class="empty" x="{x}" y="{y}" width="{width}" height="{height}"/>'
    return f'{box}<path class="hatch" d="{"".join(strokes)}"/>'


def heat(of: Mapping[str, Any], layer: str, pair: str) -> Markup:
    """Draws a map of mean residuals over two of speed, command and time.

    Each colour is one path, which keeps the picture small.
    """
    first, second = pair.split("-")
    rows, (width, height) = of["layers"][layer][pair], CELL_AREA
    across, along = of["axes"][first], of["axes"][second]
    scale, w, h = of["scale"] or 1.0, width / len(rows[0]), height / len(rows)
    paths: dict[int, list[str]] = {}
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            if value is not None:
                level = round((min(max(value / scale, -1.0), 1.0) + 1.0) / 2.0 * (LEVELS - 1))
                x, y = LEFT + j * w, 6 + (len(rows) - 1 - i) * h
                paths.setdefault(level, []).append(f"M{x:.1f} {y:.1f}h{w:.2f}v{h:.2f}h-{w:.2f}z")
    body = _hatched(LEFT, 6.0, width, height)
    body += "".join(
        f'<path class="h{level}" d="{"".join(d)}"/>' for level, d in sorted(paths.items())
    )
    for value in ticks(across["edges"][0], across["edges"][-1]):
        x = LEFT + _part(value, across["edges"]) * width
        body += (
            f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{6 + height}" y2="{10 + height}"/>'
        )
        body += _text(x, height + 22, short(value), "middle")
    for value in ticks(along["edges"][0], along["edges"][-1]):
        y = 6 + (1.0 - _part(value, along["edges"])) * height
        body += f'<line class="grid" x1="{LEFT - 4}" x2="{LEFT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        body += _text(LEFT - 6, y + 4, short(value), "end")
    body += _text(
        LEFT + width / 2, height + 35, f"{first} [{unit(across['unit']) or '1'}]", "middle"
    )
    turned = f'transform="translate(12,{6 + height / 2}) rotate(-90)" text-anchor="middle"'
    body += f"<text {turned}>{escape(second)} [{escape(unit(along['unit']) or '1')}]</text>"
    label = f"mean residual of {of['name']} over {first} and {second}, {layer} model"
    return _svg(LEFT + width + 8, height + BOTTOM + 6, label, body, "heat")


def waterfall(parts: Sequence[Mapping[str, Any]]) -> Markup:
    """Draws shares of the nominal model's squared error, one after the other."""
    left, width, row = 250, 560, 30
    drawn, at = [], 1.0
    steps = [{"what": "nominal model", "effect": False, "share": 1.0}, *parts]
    for i, part in enumerate(steps):
        y, share = 4 + row * i, float(part["share"])
        begin = 0.0 if i == 0 else at - share
        kind = {
            "nominal model": "nominal",
            SAME_NUMBERS: "same",
            NEW_NUMBERS: "refitted",
            NOISE: "floor",
            UNEXPLAINED: "left",
        }.get(str(part["what"]), "corrected")
        if i:
            drawn.append(
                f'<line class="grid" x1="{left + at * width:.1f}" '
                f'x2="{left + at * width:.1f}" y1="{y - 10}" y2="{y + 20}"/>'
            )
        drawn.append(
            f'<rect class="{kind}" x="{left + begin * width:.1f}" y="{y}" '
            f'width="{max(share * width, 1.5):.1f}" height="20" rx="2"/>'
        )
        words = "100 %" if i == 0 else percent(share)
        past = left + (begin + share) * width + 8
        drawn.append(
            _text(left - 10, y + 15, str(part["what"]), "end") + _text(past, y + 15, words)
        )
        at = begin if i else 1.0
    height = 8 + row * len(steps)
    label = "; ".join(f"{p['what']} {percent(float(p['share']))}" for p in parts)
    return _svg(
        left + width + 90,
        height,
        f"shares of the nominal model's squared error: {label}",
        "".join(drawn),
    )


def nearly(share: float) -> str:
    """Returns a share in words; one close to the whole is never rounded up to 100 %."""
    return percent(share) if share < 0.99 else f"{math.floor(1e4 * share) / 100:.2f} %"  # noqa: PLR2004


class Scale:
    """A logarithmic axis for errors, `width` wide."""

    def __init__(self, values: Sequence[float], width: float = 220.0) -> None:
        fine = [v for v in values if v > 0.0 and math.isfinite(v)] or [1.0]
        self.low, self.high, self.width = (
            math.log10(min(fine)) - 0.1,
            math.log10(max(fine)) + 0.1,
            width,
        )

    def __call__(self, value: float) -> float:
        if value <= 0.0:
            return 0.0
        return (
            min(max((math.log10(value) - self.low) / (self.high - self.low), 0.0), 1.0) * self.width
        )


class Linear:
    """An axis from one value to another, `width` wide; what lies beyond ends at its end."""

    def __init__(self, low: float, high: float, width: float = 220.0) -> None:
        self.low, self.width = low, width
        self.high = high if high > low else low + (abs(low) or 1.0)

    def holds(self, value: float) -> bool:
        """Whether a value has a place on it."""
        return self.low <= value <= self.high

    def __call__(self, value: float) -> float:
        return min(max((value - self.low) / (self.high - self.low), 0.0), 1.0) * self.width


def interval(
    scale: Scale | Linear, value: float | None, ends: Sequence[float] | None, kind: str
) -> Markup:
    """Draws a value as a dot with its interval, on a scale that rows share."""
    if value is None:
        return Markup("")
    body = f'<line class="grid" x1="0" x2="{scale.width:g}" y1="9" y2="9"/>'
    if ends is not None:
        body += (
            f'<line class="ends {kind}" x1="{scale(ends[0]):.1f}" x2="{scale(ends[1]):.1f}" '
            'y1="9" y2="9"/>'
        )
    if not isinstance(scale, Linear) or scale.holds(value):
        body += f'<circle class="{kind}" cx="{scale(value):.1f}" cy="9" r="4.5"/>'
    return _svg(scale.width, 18, f"{short(value)}", body, "interval")


def share_bar(share: float) -> Markup:
    """Draws a share, 0 to 1, as a bar."""
    body = '<rect class="track" width="200" height="8" rx="3"/>'
    body += f'<rect class="bar" width="{200 * min(max(share, 0.0), 1.0):.1f}" height="8" rx="3"/>'
    return _svg(200, 8, percent(share), body, "share")


def sparkline(values: Sequence[float | None], label: str, threshold: float | None = None) -> Markup:
    """Draws a small line; a dashed one at the threshold of an alarm."""
    width, height = SPARK
    if not [v for v in values if v is not None]:
        return Markup("")
    low, high = span_of([*values, threshold, 0.0])
    points: Pairs = [(float(i), v) for i, v in enumerate(values)]
    box = (2.0, 2.0, width - 4.0, height - 4.0)
    across = (0.0, max(len(values) - 1.0, 1.0))
    body = "".join(
        f'<polyline class="line corrected" points="{piece}"/>'
        for piece in _runs(points, across, (low, high), box)
    )
    if threshold is not None:
        y = box[1] + (high - threshold) / (high - low) * box[3]
        body += f'<line class="limit" x1="2" x2="{width - 2}" y1="{y:.1f}" y2="{y:.1f}"/>'
    return _svg(width, height, label, body, "spark")
