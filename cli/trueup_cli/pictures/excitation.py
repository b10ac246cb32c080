"""A designed excitation as one SVG: the command, and the motion under every plausible model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.collect.bounds import DECLARED, RECORDED, UNBOUNDED
from trueup.collect.excitation import Excitation
from trueup.model.plant import Plant
from trueup_cli.pictures.drawing import (
    PALE,
    SERIES,
    WIDTH,
    Panel,
    legend,
    nice,
    range_of,
    sheet,
    text,
)

Array = NDArray[np.float64]
PANEL, GAP, TOP = 130, 54, 98
BOUND = "#c23030"


def excite_picture(plant: Plant, excitation: Excitation) -> str:
    """Draws a panel for each command and observation, with limits and envelope as dashed lines."""
    span = nice(0.0, float(excitation.t_s[-1]))
    parts: list[str] = []
    top = float(TOP)
    for channel in plant.layout.commands:
        values = excitation.command[:, plant.joint_of(channel)]
        limits = channel.limits or (float(values.min()), float(values.max()))
        panel = Panel(top, PANEL, span, nice(*range_of([values, np.array(limits)])))
        parts += [
            panel.frame(f"{channel.name} [{channel.unit}]"),
            *(_level(panel, x) for x in limits),
            panel.line(excitation.t_s, values, SERIES[0]),
        ]
        top += PANEL + GAP
    kept, sources = excitation.bounds.whole(), excitation.bounds.sources
    for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
        paths = excitation.paths[:, :, column]
        bounds = tuple(kept[column]) if sources[column] != UNBOUNDED else ()
        low, high = paths.min(axis=0), paths.max(axis=0)
        panel = Panel(top, PANEL, span, nice(*range_of([low, high, np.array(bounds)])))
        parts += [
            panel.frame(f"{channel.name} [{channel.unit}]", times=True),
            *(_level(panel, x) for x in bounds),
        ]
        parts += [_band(panel, excitation.t_s, low, high), *_centres(panel, excitation, paths)]
        top += PANEL + GAP
    parts += [
        legend(
            [
                *zip(_names(excitation), SERIES, strict=False),
                (f"limit, {_envelope(plant, excitation)}", BOUND),
            ],
            78,
        ),
        text(WIDTH / 2, top - 8, "time [s]", PALE, anchor="middle"),
    ]
    words = (
        f"{len(excitation.paths)} models drawn anew, {excitation.breaches} breaches of the "
        f"{_envelope(plant, excitation)}, of which "
        f"{100 * excitation.bounds.margin:.0f} % is kept free"
    )
    return sheet(f"{plant.name}: a bounded excitation", words, round(top + 10), parts)


def _envelope(plant: Plant, excitation: Excitation) -> str:
    """Returns where the bounds of the travel come from, in words."""
    of = set(excitation.bounds.sources[: len(plant.joints)])
    return (
        "declared envelope"
        if of == {DECLARED}
        else "recorded range"
        if of == {RECORDED}
        else "declared envelope and recorded range"
    )


def _names(excitation: Excitation) -> list[str]:
    """Returns the name of each composition's line."""
    names = list(excitation.central)
    return [
        f"command; {names[0]}" if len(names) > 1 else "command; motion of the central model",
        *names[1:],
    ]


def _centres(panel: Panel, excitation: Excitation, paths: Array) -> list[str]:
    """Draws the central motion of each composition, the answer's above the others."""
    lines = [
        panel.line(excitation.t_s, paths[i], colour, width=1.2)
        for i, colour in zip(excitation.central.values(), SERIES, strict=False)
    ]
    return lines[::-1]


def _level(panel: Panel, value: float) -> str:
    x, end, y = panel.x(0.0), WIDTH - 24, panel.y(value)
    return f'<path d="M{x:.1f} {y:.1f}H{end}" stroke="{BOUND}" stroke-dasharray="5 4"/>'


def _band(panel: Panel, t_s: Array, low: Array, high: Array) -> str:
    every = max(1, len(t_s) // WIDTH)
    there = [
        f"{panel.x(t):.1f} {panel.y(y):.1f}"
        for t, y in zip(t_s[::every], high[::every], strict=True)
    ]
    back = [
        f"{panel.x(t):.1f} {panel.y(y):.1f}"
        for t, y in zip(t_s[::-every], low[::-every], strict=True)
    ]
    return f'<path d="M{"L".join(there + back)}Z" fill="{SERIES[0]}" opacity="0.25"/>'
