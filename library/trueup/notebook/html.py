"""The answer as HTML for a notebook: the sentence, the map of what is missed, the ranking. It loads
nothing, and takes its colours from the page that it stands in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from trueup.diagnose.number_text import short
from trueup.diagnose.summary_text import composition, sentence
from trueup.diagnose.summary_warnings import warnings
from trueup.notebook.ranking import ranked

CELL, LEFT, BOTTOM = 18, 74, 34  # of a map [px]
MOST_RANKED = 8
LAYERS = ("nominal", "corrected")
UNDER, OVER = "#2b6cb0", "#c05621"  # predicted too low, too high


def diagnosis_html(report: Mapping[str, Any], figures: Mapping[str, Any]) -> str:
    """A diagnosis as a fragment of HTML."""
    maps = "".join(
        _map(of_channel, layer) for of_channel in figures["maps"][:2] for layer in LAYERS
    )
    remark = "".join(f"<li>{escape(w)}</li>" for w in warnings(report))
    return (
        "<div class='trueup' style='max-width:60em'>"
        f"<p><strong>{escape(sentence(report))}</strong></p>"
        + (f"<ul>{remark}</ul>" if remark else "")
        + f"<div style='display:flex;flex-wrap:wrap;gap:1em'>{maps}</div>"
        + _ranking(report)
        + "</div>"
    )


def _ranking(report: Mapping[str, Any]) -> str:
    rows = ranked(report)[:MOST_RANKED]
    cells = "".join(
        f"<tr><td>{escape(_words(h))}</td><td style='text-align:right'>{short(h['validation'])}"
        f"</td><td>{_standing(h)}</td></tr>"
        for h in rows
    )
    return (
        "<table><thead><tr><th>what explains it</th><th>reduced chi-square, held out</th>"
        "<th></th></tr></thead>"
        f"<tbody>{cells}</tbody></table>"
    )


def _words(hypothesis: Mapping[str, Any]) -> str:
    numbers = (
        "nominal parameters" if hypothesis["parameters"] == "nominal" else "refitted parameters"
    )
    effects = hypothesis["effects"]
    return f"{composition(effects)}, {numbers}" if effects else numbers


def _standing(hypothesis: Mapping[str, Any]) -> str:
    if hypothesis.get("answer"):
        return "the answer"
    return "cannot be told from the answer" if hypothesis.get("in_set") else ""


def _map(channel: Mapping[str, Any], layer: str) -> str:
    """What a model misses of a channel, over speed and command."""
    rows: Sequence[Sequence[float | None]] = channel["layers"][layer]["speed-command"]
    speed, command = channel["axes"]["speed"], channel["axes"]["command"]
    across, along = len(rows), len(rows[0])
    width, height = LEFT + CELL * across + 8, CELL * along + BOTTOM
    squares = "".join(
        _square(LEFT + CELL * i, CELL * (along - 1 - j), value, channel["scale"])
        for i, row in enumerate(rows)
        for j, value in enumerate(row)
    )
    ends = (
        (LEFT, height - 20, "start", short(speed["edges"][0])),
        (LEFT + CELL * across, height - 20, "end", short(speed["edges"][-1])),
        (LEFT + CELL * across / 2, height - 5, "middle", _with_unit("speed", speed["unit"])),
        (LEFT - 4, CELL * along, "end", short(command["edges"][0])),
        (LEFT - 4, 10, "end", short(command["edges"][-1])),
        (LEFT - 4, CELL * along / 2, "end", _with_unit("command", command["unit"])),
    )
    texts = "".join(
        f"<text x='{x:g}' y='{y:g}' text-anchor='{anchor}'>{escape(words)}</text>"
        for x, y, anchor, words in ends
    )
    title = f"{_with_unit(channel['name'], channel['unit'])}, {layer} model"
    label = (
        f"Mean residual of {title} over speed and command; the darkest is "
        f"{short(channel['scale'])} {channel['unit']}"
    )
    return (
        "<figure style='margin:0'>"
        f"<figcaption>{escape(title)}<br><small>darkest: ± {short(channel['scale'])} "
        f"{escape(channel['unit'])}</small></figcaption>"
        f"<svg width='{width}' height='{height}' role='img' aria-label='{escape(label)}' "
        "font-size='11' fill='currentColor' xmlns='http://www.w3.org/2000/svg'>"
        f"{squares}{texts}</svg></figure>"
    )


def _with_unit(words: str, unit: str) -> str:
    return f"{words} [{unit}]" if unit else words


def _square(x: float, y: float, value: float | None, scale: float) -> str:
    place = f"x='{x:g}' y='{y:g}' width='{CELL - 1}' height='{CELL - 1}'"
    if value is None:
        return f"<rect {place} fill='none' stroke='currentColor' stroke-opacity='0.15'/>"
    strength = min(1.0, abs(value) / scale) if scale else 0.0
    colour = OVER if value > 0.0 else UNDER
    return (
        f"<rect {place} fill='{colour}' fill-opacity='{0.06 + 0.94 * strength:.2f}'>"
        f"<title>{value:.3g}</title></rect>"
    )
