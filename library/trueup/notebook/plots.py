"""Pictures of a diagnosis by matplotlib, for a notebook or a paper."""

from __future__ import annotations

import importlib
from io import BytesIO
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from trueup.diagnose.summary_text import composition
from trueup.errors import NotInstalled
from trueup.notebook.ranking import ranked

if TYPE_CHECKING:
    from trueup.notebook.diagnosis import Diagnosis

LAYERS = ("nominal", "corrected")
MOST_RANKED = 10
LONGEST_LINE = 40  # characters of a composition's name beside its bar


def _shown(figure: Any) -> Any:
    """The figure's class, with the picture by which a notebook shows it."""

    def _repr_png_(self: Any) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=100)
        return stream.getvalue()

    return type("Picture", (figure,), {"_repr_png_": _repr_png_})


class Plots:
    """Pictures of one diagnosis. Each returns the figure; nothing is shown or written."""

    def __init__(self, diagnosis: Diagnosis) -> None:
        self._diagnosis = diagnosis
        try:
            self._figure = _shown(importlib.import_module("matplotlib.figure").Figure)
        except ImportError as error:
            raise NotInstalled(
                "pictures need matplotlib, which is not installed",
                hint="Install it with `pip install 'trueup[plot]'`.",
            ) from error

    def where(self) -> Any:
        """What the nominal and the corrected model miss of each channel over short strides, over
        speed and command."""
        maps = self._diagnosis.figures["maps"]
        figure = self._figure(figsize=(7.0, 2.8 * len(maps)), layout="constrained")
        axes = figure.subplots(len(maps), len(LAYERS), squeeze=False, sharex="row", sharey="row")
        for of_channel, row in zip(maps, axes, strict=True):
            speed, command = of_channel["axes"]["speed"], of_channel["axes"]["command"]
            for layer, axis in zip(LAYERS, row, strict=True):
                cells = np.array(of_channel["layers"][layer]["speed-command"], float).T
                limit = of_channel["scale"] or 1.0
                mesh = axis.pcolormesh(
                    speed["edges"],
                    command["edges"],
                    cells,
                    cmap="PuOr_r",
                    vmin=-limit,
                    vmax=limit,
                )
                axis.set_title(f"{layer} model", fontsize="medium")
                axis.set_xlabel(f"speed [{speed['unit']}]")
            row[0].set_ylabel(f"command [{command['unit'] or '1'}]")
            bar = figure.colorbar(mesh, ax=list(row))
            bar.set_label(f"residual of {of_channel['name']} [{of_channel['unit']}]")
        return figure

    def ranking(self) -> Any:
        """The compositions that were tried, by their reduced chi-square on held-out episodes, the
        answer first."""
        rows = ranked(self._diagnosis.report)[:MOST_RANKED]
        names = [
            fill(
                composition(h["effects"]) if h["effects"] else f"{h['parameters']} numbers alone",
                LONGEST_LINE,
            )
            for h in rows
        ]
        lines = sum(1 + name.count("\n") for name in names)
        figure = self._figure(
            figsize=(7.0, 0.7 + 0.12 * len(rows) + 0.2 * lines), layout="constrained"
        )
        axis = figure.subplots()
        colours = [
            "tab:blue" if h.get("answer") else "tab:cyan" if h.get("in_set") else "0.7"
            for h in rows
        ]
        axis.barh(range(len(rows)), [h["validation"] for h in rows], color=colours)
        axis.set_yticks(range(len(rows)), names, fontsize="small")
        axis.invert_yaxis()
        axis.set_xscale("log")
        axis.set_xlabel("reduced chi-square on held-out episodes")
        return figure

    def predictions(self, episode: int = 0) -> Any:
        """A held-out episode: what was measured, and what both models predict of it window by
        window."""
        drawn = self._diagnosis.figures["episodes"][episode]
        channels = drawn["channels"]
        figure = self._figure(figsize=(7.0, 2.2 * len(channels)), layout="constrained")
        axes = figure.subplots(len(channels), 1, squeeze=False, sharex=True)[:, 0]
        for of_channel, axis in zip(channels, axes, strict=True):
            for key, style in (("measured", "k-"), ("nominal", "C1-"), ("corrected", "C0-")):
                values = np.array(of_channel[key], float)
                axis.plot(drawn["t_s"], values, style, lw=1.0, label=key)
            axis.set_ylabel(f"{of_channel['name']} [{of_channel['unit']}]")
        axes[0].legend(frameon=False, ncols=3, fontsize="small")
        axes[-1].set_xlabel("time [s]")
        return figure
