"""Two models before and after as one SVG: measurement, predictions by window, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup_cli.pictures.drawing import INK, PALE, WIDTH, Panel, legend, nice, range_of, sheet, text

Array = NDArray[np.float64]
TOP_PANEL, BOTTOM_PANEL, HEIGHT = (92, 250), (392, 170), 640  # (top, height)
MEASURED, BEFORE, AFTER = "#1f2933", "#d9822b", "#137cbd"


@dataclass(frozen=True, slots=True)
class Trace:
    """One model's prediction at every sample `(samples,)`, and its RMS error in words."""

    name: str
    values: Array
    rms: str
    colour: str


def before_and_after(
    title: str,
    subtitle: str,
    t_s: Array,
    measured: Array,
    traces: Sequence[Trace],
    starts_s: Array,
    unit: str,
) -> str:
    """Draws the picture.

    Rollouts start anew at `starts_s` [s]. Errors are drawn in thousandths of `unit`.
    """
    span = nice(float(t_s[0]), float(t_s[-1]))
    upper = Panel(*TOP_PANEL, span, nice(*range_of([measured, *(t.values for t in traces)])))
    lower = Panel(
        *BOTTOM_PANEL, span, nice(*range_of([1e3 * (t.values - measured) for t in traces]))
    )
    note = (
        "time [s]; each rollout runs on the issued commands alone until the next tick below "
        "the axis"
    )
    parts = [
        legend([("measured", MEASURED), *((f"{t.name} ({t.rms})", t.colour) for t in traces)]),
        upper.frame(f"position [{unit}]"),
        *(upper.line(t_s, t.values, t.colour, breaks=starts_s) for t in traces),
        upper.line(t_s, measured, MEASURED, width=1.2, dash="2 3"),
        lower.frame(f"prediction − measured [m{unit}]", times=True),
        *(lower.line(t_s, 1e3 * (t.values - measured), t.colour, breaks=starts_s) for t in traces),
        text(WIDTH / 2, 614, note, PALE, anchor="middle"),
        *(f'<path d="M{lower.x(s):.1f} {lower.bottom}v6" stroke="{INK}"/>' for s in starts_s),
    ]
    return sheet(title, subtitle, HEIGHT, parts)
