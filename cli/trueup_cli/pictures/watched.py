"""What a plant's monitors saw as one SVG: detector statistics over their levels, and each channel's
error, by episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup_cli.pictures.drawing import INK, PALE, SERIES, WIDTH, Panel, legend, nice, sheet, text

Array = NDArray[np.float64]
TOP_PANEL, BOTTOM_PANEL, HEIGHT = (136, 192), (404, 160), 640
MOST = 3.0  # times the level; larger statistics are drawn at the edge
ALARM = "#c23030"


@dataclass(frozen=True, slots=True)
class Watched:
    """What one monitor saw of one version: the monitor's document, and each episode's record."""

    version: int
    monitor: Mapping[str, Any]
    watches: Sequence[Mapping[str, Any]]


def watch_picture(plant: str, monitors: Sequence[Watched]) -> str:
    """Draws the monitors one after the other, each in its own healthy spreads and levels."""
    monitors = [
        Watched(w.version, w.monitor, [one for one in w.watches if "channels" in one["seen"]])
        for w in monitors
    ]
    monitors = [w for w in monitors if w.watches]
    detectors = list(dict.fromkeys(d["detector"] for w in monitors for d in w.monitor["detectors"]))
    channels = list(monitors[0].watches[0]["seen"]["channels"])
    hours, begins, now = [], [], 0.0
    for watched in monitors:
        begins.append(now)
        hours.append(now + np.cumsum([w["seen"]["seconds"] for w in watched.watches]) / 3600.0)
        now = float(hours[-1][-1])
    rms = [
        {c: np.array([w["seen"]["channels"][c]["rms"] for w in watched.watches]) for c in channels}
        for watched in monitors
    ]
    span = nice(0.0, now)
    upper = Panel(*TOP_PANEL, span, nice(0.0, MOST))
    lower = Panel(
        *BOTTOM_PANEL, span, nice(0.0, float(max(r.max() for one in rms for r in one.values())))
    )
    colours, of_channel = (
        dict(zip(names, SERIES, strict=False)) for names in (detectors, channels)
    )
    parts = [
        legend([(d.replace("_", " "), colours[d]) for d in detectors], 80),
        upper.frame("statistic / level; above 1 is an alarm"),
        (
            f'<path d="M{upper.x(span[0]):.1f} {upper.y(1.0):.1f}H{upper.x(span[-1]):.1f}" '
            f'stroke="{INK}" stroke-dasharray="5 4"/>'
        ),
        lower.frame(
            "error of each channel, in the spreads that are healthy for the model that serves",
            times=True,
        ),
        legend([(c, of_channel[c]) for c in channels], 600),
        text(WIDTH / 2, 626, "operating hours; triangles are alarms", PALE, anchor="middle"),
    ]
    for watched, times, begin, errors in zip(monitors, hours, begins, rms, strict=True):
        parts += [_begun(upper, lower, begin, f"version {watched.version}")]
        for d in watched.monitor["detectors"]:
            share = np.minimum(
                [w["seen"]["highest"][d["detector"]] / d["level"] for w in watched.watches], MOST
            )
            parts.append(upper.line(times, share, colours[d["detector"]]))
        raised = [t for t, w in zip(times, watched.watches, strict=True) if w["seen"]["alarms"]]
        parts += [
            f'<path d="M{upper.x(t):.1f} {upper.bottom + 4:.1f}l-5 9h10z" fill="{ALARM}"/>'
            for t in raised
        ]
        parts += [lower.line(times, values, of_channel[c]) for c, values in errors.items()]
    episodes = sum(len(w.watches) for w in monitors)
    words = (
        f"{episodes} episodes, {now:.2f} h; one false alarm in "
        f"{monitors[-1].monitor['promise_h']:g} h is promised"
    )
    return sheet(f"{plant}: is the model still right?", words, HEIGHT, parts)


def _begun(upper: Panel, lower: Panel, at: float, name: str) -> str:
    """Marks where another model began to serve."""
    x = upper.x(at)
    line = (
        f'<path d="M{x:.1f} {upper.top - 22}V{lower.bottom}" stroke="{PALE}" '
        'stroke-dasharray="2 3"/>'
    )
    return line + text(x + 6, upper.top - 26, name, INK, weight=600)
