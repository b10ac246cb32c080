"""`trueup identifiability CASE`: what the recordings of a case can show, before anything is
sought."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trueup.diagnose.case import read_case
from trueup.diagnose.identifiability import (
    EffectShown,
    Identifiability,
    ParameterShown,
    identifiability_of,
)
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say, table

MOST_TIES = 3  # that a table shows
WIDEST = 100.0  # of a number: wider is said as nothing
SCHEMA = "trueup.identifiability/1"


def identifiability(case: Path, *, as_json_: Json = False) -> None:
    """Show which parameters and which effects the recordings of a case can show.

    Each is identifiable, weak, or not identifiable, while everything else is fitted, too. For an
    effect the table gives the smallest size that these recordings would detect.

    Parameters
    ----------
    case
        folder with plant.json and *.mcap episodes
    """
    with progress("identifiability") as bar:
        bar(0.0, "reading the episodes")
        plant, episodes = read_case(case)
        shown = identifiability_of(plant, episodes, lambda stage, part: bar(part, stage))
    if as_json_:
        as_json({"schema": SCHEMA, "plant": plant.name, **shown.document()})
        return
    _show(plant.name, shown)


def _show(plant: str, shown: Identifiability) -> None:
    table(
        f"{plant}: parameters",
        ["parameter", "shown", "value", "95 % within", "tied to"],
        [_parameter(p) for p in shown.parameters],
    )
    say("")
    table(
        f"{plant}: effects",
        ["effect", "shown", "smallest detectable", "tied to", "why not"],
        [_effect(e) for e in shown.effects],
    )


def _parameter(p: ParameterShown) -> list[Any]:
    within = f"± {100.0 * p.within:.2g} %" if p.within < WIDEST else "–"
    return [p.parameter, _words(p.shown), f"{p.value:.4g}", within, _ties(p.tied_to)]


def _effect(e: EffectShown) -> list[Any]:
    name = f"{e.effect} at {e.joint}" if e.joint else e.effect
    weakest = f"{e.parameter} {e.weakest:.3g} {e.unit}" if e.weakest is not None else "–"
    return [name, _words(e.shown), weakest, _ties(e.tied_to), e.why]


def _ties(names: Sequence[str]) -> str:
    more = len(names) - MOST_TIES
    return ", ".join(names[:MOST_TIES]) + (f" and {more} more" if more > 0 else "")


def _words(shown: str) -> str:
    return shown.replace("_", " ")
