"""What a monitor saw as one SVG: each detector's statistic against its level, and each channel's error, episode by episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trueup_cli.drawing import INK, PALE, SERIES, WIDTH, Panel, legend, nice, sheet, text

TOP_PANEL, BOTTOM_PANEL, HEIGHT = (122, 206), (392, 170), 640
MOST = 3.0  # times the level: what is far beyond is drawn at the edge


def watch_picture(plant: str, monitor: Mapping[str, Any], watches: Sequence[Mapping[str, Any]]) -> str:
    """The picture of a monitor's document and what it saw."""
    hours = np.cumsum([w["seen"]["seconds"] for w in watches]) / 3600.0
    levels = {d["detector"]: d["level"] for d in monitor["detectors"]}
    channels = list(watches[0]["seen"]["channels"])
    rms = {c: np.array([w["seen"]["channels"][c]["rms"] for w in watches]) for c in channels}
    span = nice(0.0, float(hours[-1]))
    upper = Panel(*TOP_PANEL, span, nice(0.0, MOST))
    lower = Panel(*BOTTOM_PANEL, span, nice(0.0, float(max(r.max() for r in rms.values()))))
    raised = [(h, w["seen"]["alarms"]) for h, w in zip(hours, watches, strict=True) if w["seen"]["alarms"]]
    parts = [
        legend([(d.replace("_", " "), c) for d, c in zip(levels, SERIES, strict=False)], 82),
        upper.frame("statistic / level; an alarm above 1"),
        f'<path d="M{upper.x(span[0]):.1f} {upper.y(1.0):.1f}H{upper.x(span[-1]):.1f}" stroke="{INK}" stroke-dasharray="5 4"/>',
        *(
            upper.line(hours, np.minimum([w["seen"]["highest"][d] / level for w in watches], MOST), colour)
            for (d, level), colour in zip(levels.items(), SERIES, strict=False)
        ),
        *(f'<path d="M{upper.x(h):.1f} {TOP_PANEL[0]}l-5 -9h10z" fill="{SERIES[4]}"/>' for h, _ in raised),
        lower.frame("error of each channel [healthy spreads]", times=True),
        *(lower.line(hours, r, colour) for r, colour in zip(rms.values(), SERIES, strict=False)),
        legend([(c, colour) for c, colour in zip(channels, SERIES, strict=False)], BOTTOM_PANEL[0] - 10),
        text(WIDTH / 2, 614, "operating hours since the calibration; triangles are alarms", PALE, anchor="middle"),
    ]
    words = f"{len(watches)} episodes, {hours[-1]:.2f} h; one false alarm in {monitor['promise_h']:g} h was promised"
    return sheet(f"{plant}: is the model still right?", words, HEIGHT, parts)
