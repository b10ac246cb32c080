"""Lot: which effects a machine is given, how large, and what the label says of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.blindtrial.bench import nominal
from trueup.canonical import Json
from trueup.diagnose.twins import TWINS
from trueup.model.effect import effects
from trueup.model.plant import Plant
from trueup.simulate.machine import BEYOND
from trueup.simulate.trial import CATALOGUE, Bench, Trial, draw

PARTS = {"single": 0.6, "pair": 0.12, "outside": 0.1, "none": 0.1, "faint": 0.08}
GAPS = (0.06, 0.5)  # of the motion: what an effect changes of the position
FAINT = (0.3, 2.0)  # times the noise
LEAST_FAINT = 1e-3  # of the motion, where there is no noise
SPREAD = (0.85, 1.15)  # of the numbers that fit the user's episodes
AS_NOMINAL = 0.25  # of the machines have the nominal numbers
ON_A_SPRING = ("k_modulated", "asymmetric_stiffness")
REDRAWN = 5  # times a machine that runs away is drawn again


@dataclass(frozen=True, slots=True)
class Lot:
    """One machine's fate. A lot of kind `none` has no effect and names a `bait`: what only somebody who read the label can answer."""

    kind: str
    effects: tuple[str, ...]
    moved: bool
    bait: str | None


def left_out(plant: Plant) -> tuple[str, ...]:
    """Effects that the nominal form takes up on this plant's channels: they make no gap, and nothing could name them."""
    found = []
    if "k" not in plant.dynamics.parameter_names:
        found += ["sensor_bias"]  # nothing says where zero is
    if len(plant.state_columns) == 1:
        found += ["velocity_lag", "sensor_scale", "clock_skew"]  # there is none; other numbers of the form give the same positions
        found += ["sensor_drift"] if "sensor_bias" in found else []  # a constant force gives the same
    return tuple(found)


def draw_lots(plant: Plant, count: int, rng: np.random.Generator) -> list[Lot]:
    """So many lots in the proportions of PARTS, in random order; single effects come in turn, so that each is met as often."""
    known = [name for name in CATALOGUE if name not in left_out(plant)]
    fitted = [name for name in known if name != "dropped_frames"]  # a frame is lost or is not: no loss is faint
    beyond = [name for name in BEYOND if name not in ON_A_SPRING or "k" in plant.dynamics.parameter_names]
    kinds = ["none", *(kind for kind, part in PARTS.items() for _ in range(round(part * count) - (kind == "none")))]  # one bait at least
    kinds = (kinds + ["single"] * count)[:count]
    turns = {kind: _turns({"outside": beyond, "faint": fitted}.get(kind, known), rng) for kind in PARTS}
    lots = []
    for kind in kinds:
        moved = bool(rng.random() >= AS_NOMINAL)
        if kind == "none":
            lots.append(Lot(kind, (), moved, next(turns[kind])))
        elif kind == "pair":
            first = next(turns[kind])
            lots.append(Lot(kind, (first, next(n for n in turns[kind] if _apart(first, n))), moved, None))
        else:
            lots.append(Lot(kind, (next(turns[kind]),), moved, None))
    return [lots[i] for i in rng.permutation(len(lots))]


def _apart(one: str, other: str) -> bool:
    """Whether two effects are two: neither the same, nor of one law, nor twins."""
    laws = {effects()[n].same_as or n for n in (one, other)}
    return len(laws) == 2 and frozenset((one, other)) not in TWINS  # noqa: PLR2004


def _turns(names: Sequence[str], rng: np.random.Generator) -> Iterator[str]:
    """The names in random order, again and again."""
    while True:
        yield from (names[i] for i in rng.permutation(len(names)))


def machine_of(plant: Plant, bench: Bench, lot: Lot, rng: np.random.Generator) -> Trial:
    """A machine of a lot and its recordings."""
    gaps = GAPS
    if lot.kind == "faint":
        noise = max(bench.noise, LEAST_FAINT)
        gaps = (FAINT[0] * noise, FAINT[1] * noise)
    own = bench if lot.moved else nominal(plant, bench)
    for _ in range(REDRAWN):
        trial = draw(own, lot.effects, lot.moved, rng, gaps, SPREAD)
        if all(np.isfinite(run.observed).all() and np.isfinite(run.issued).all() for _, run in trial.runs):
            break
    return trial


def label_of(plant: Plant, lot: Lot, trial: Trial) -> Mapping[str, Json]:
    """What is true of a machine: its effects with their numbers, its parameters, the gap that an effect makes."""
    m = trial.machine
    numbers = {"k": m.k, "c": m.c, "b": m.b}
    return {
        "kind": lot.kind,
        "effects": {name: {k: float(v) for k, v in values.items()} for name, values in m.imperfections.items()},
        "parameters": {name: float(numbers[name]) for name in plant.dynamics.parameter_names},
        "moved": lot.moved,
        "bait": lot.bait,
        "gap": float(trial.gap),
    }
