"""Blind trials under what recordings of real machines have besides an effect: noise that is
coloured and has outliers, commands that are lines between samples, states that are stamped late and
mended as the doctor says, closed loops, gaps.

Machines of the second simulator, on tiers with noise: an oscillator, a pendulum, an axis in a loop.
Each trial hides one effect, two, none, one beyond the catalogue, or one about as large as the
noise, and has one nuisance. A topic that is late is part of the truth, and may be named or not.
Scored as a blind trial. `TRIALS=60` makes so many of the visible ones and as large a part of the
others; `PUBLISH=1` keeps the table for the pages.
"""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from bench.report import Figure, publish, show
from tests.support.simulated import episodes_of, plant_of
from tests.support.spoilt import as_recorded, gap
from trueup.blindtrial.scoring import Answer, bound_holds, score_answer, score_intervals
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.indistinguishable import ALIASES
from trueup.doctor.examine import examine
from trueup.doctor.finding import Fault
from trueup.doctor.mends import Shifted
from trueup.episode.episode import Episode
from trueup.fit.fitter import warm
from trueup.model.plant import Plant
from trueup.simulate.machine import BEYOND
from trueup.simulate.noise import NoiseModel
from trueup.simulate.trial import CATALOGUE, draw, draw_bench

NUISANCES = "coloured noise", "ramps", "late states", "closed loop", "gaps"
COUNTED = "sensor_quantization", "dropped_frames"
# nothing shows them on a bare inertia
NO_SPRING = "sensor_bias", "sensor_drift", "k_modulated", "asymmetric_stiffness"
# a late topic is the same
LATE = "actuator_delay", "sensor_delay"
COLOURED = NoiseModel(0.7, 4.0)
LATE_S = 0.01, 0.05
VISIBLE = 0.06, 0.5  # of the motion
FAINT = 0.3, 2.0  # times the noise
TRIALS = int(os.environ.get("TRIALS", "300"))
PARTS = {"single": 0.66, "pair": 0.12, "outside": 0.11, "none": 0.11, "faint": 1.3}
SEED = 50500


@dataclass(frozen=True)
class Trial:
    """What is hidden in one machine, under which nuisance, and the seed that draws it."""

    kind: str
    names: tuple[str, ...]
    nuisance: str
    tier: str
    seed: int


@dataclass(frozen=True)
class Row:
    """What one diagnosis answered."""

    trial: Trial
    right: bool
    answer: str
    effects_held: tuple[bool, ...]
    parameters_held: tuple[bool, ...]
    bound: bool | None
    seconds: float


def trials() -> list[Trial]:
    """What is hidden where: effects in turn, nuisances in turn."""
    rng = np.random.default_rng(SEED)
    known = [n for n in CATALOGUE if n not in COUNTED]
    wanted = []
    for kind, part in PARTS.items():
        for i in range(round(part * TRIALS)):
            nuisance = NUISANCES[(i + i // len(known)) % len(NUISANCES)]
            tier = "B2" if nuisance == "closed loop" else str(rng.choice(["A1", "B1"]))
            names = _names(kind, i, nuisance, tier, known, rng)
            wanted.append(Trial(kind, names, nuisance, tier, SEED + 1000 * len(wanted) + i))
    return wanted


def _names(
    kind: str, i: int, nuisance: str, tier: str, known: list[str], rng: np.random.Generator
) -> tuple[str, ...]:
    """The effects of the i-th trial of a kind that its machine can show."""
    if kind == "none":
        return ()
    hidden_by = (*NO_SPRING, *(LATE if nuisance == "late states" else ()))
    hidden_by = hidden_by if tier == "B2" else hidden_by[len(NO_SPRING) :]
    known = [n for n in (BEYOND if kind == "outside" else known) if n not in hidden_by]
    if kind == "pair":
        while True:
            first, other = (str(n) for n in rng.choice(known, 2, replace=False))
            if frozenset((first, other)) not in ALIASES:
                return first, other
    return (known[i % len(known)],)


def recorded(trial: Trial) -> tuple[Plant, list[Episode], dict]:
    """A trial's plant, its episodes with the nuisance, and its label."""
    rng = np.random.default_rng(trial.seed)
    bench = draw_bench(trial.tier, rng)
    law = COLOURED if trial.nuisance in ("coloured noise", "closed loop") else bench.law
    bench = replace(bench, law=law, ramped=trial.nuisance == "ramps")
    gaps = (
        (FAINT[0] * bench.noise, FAINT[1] * bench.noise) if trial.kind == "faint" else (0.06, 0.5)
    )
    machine = draw(bench, list(trial.names), True, rng, gaps)
    plant = plant_of(bench)
    episodes = episodes_of(plant, machine)
    if trial.nuisance == "late states":
        late_s = float(rng.uniform(*LATE_S))
        stamped = [as_recorded(plant, e, late_s=late_s) for e in episodes]
        mended_s = _advised_s(plant, stamped)
        episodes = [as_recorded(plant, e, late_s=late_s - mended_s) for e in episodes]
    elif trial.nuisance == "gaps":
        episodes = gap(plant, episodes)
    label = {
        "kind": trial.kind if trial.kind != "faint" else "single",
        "effects": {n: dict(v) for (n, _), v in machine.machine.by_joint().items()},
        "parameters": {
            n: v for n, v in machine.machine.parameters().items() if n in dict(plant.nominal)
        },
        "moved": True,
        "bait": None,
    }
    return plant, episodes, label


def _advised_s(plant: Plant, episodes: list[Episode]) -> float:
    """By how much the doctor advises to move the stamps of observations back [s]."""
    late = [f for f in examine(plant, episodes) if f.fault is Fault.TOPIC_OFFSET]
    mends = [m.late_s for f in late for m in f.mends if isinstance(m, Shifted)]
    return mends[0] if mends else 0.0


def scored(trial: Trial) -> Row:
    """Diagnose one machine, and score the answer."""
    plant, episodes, label = recorded(trial)
    began = time.process_time()
    report = dict(diagnose(plant, episodes).document)
    seconds = time.process_time() - began
    labels = [label]
    if trial.nuisance == "late states":  # what is late is named, or it is not
        late = {"sensor_delay": {}}
        kind = "single" if label["kind"] == "none" else label["kind"]
        labels.append({**label, "kind": kind, "effects": {**label["effects"], **late}})
    answer = Answer(report, None, seconds)
    right = any(score_answer(x, answer)["exact"] for x in labels)
    held = [h for x in labels for h in score_intervals(x, answer)]
    effects = [e["effect"] for e in report["effects"]]
    return Row(
        trial,
        right,
        " + ".join(effects) or str(report["verdict"]),
        tuple(h["holds"] for h in held if h["of"]),
        tuple(h["holds"] for h in held if not h["of"]),
        bound_holds(label, answer),
        seconds,
    )


def main() -> None:
    """Run all trials, and print and keep the table."""
    wanted = trials()
    rows = []
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), initializer=warm) as pool:
        for row in pool.map(scored, wanted):
            rows.append(row)
            if not row.right and row.trial.kind != "faint":
                t = row.trial
                print(f"{t.nuisance}, {t.tier}, {t.names}, {t.seed}: {row.answer}", flush=True)
            if row.bound is False:
                print(f"  bound: {row.trial}", flush=True)
            print(f"{len(rows)} of {len(wanted)}", end="\r", file=sys.stderr, flush=True)
    visible = [r for r in rows if r.trial.kind != "faint"]
    bounds = [r.bound for r in rows if r.bound is not None]
    effects = [x for r in visible for x in r.effects_held]
    parameters = [x for r in visible for x in r.parameters_held]
    figures = [Figure("right", *_share([r.right for r in visible], 0.95, 1.0))]
    table = []
    for nuisance in NUISANCES:
        mine = [r for r in visible if r.trial.nuisance == nuisance]
        kinds = [_count([r.right for r in mine if r.trial.kind == k]) for k in list(PARTS)[:4]]
        own = [b for r in rows if r.trial.nuisance == nuisance and (b := r.bound) is not None]
        held = [x for r in mine for x in (*r.effects_held, *r.parameters_held)]
        table.append([nuisance, *kinds, _count(held), _count(own)])
    table.append(
        [
            "**all**",
            *[_count([r.right for r in visible if r.trial.kind == k]) for k in list(PARTS)[:4]],
            _count([*effects, *parameters]),
            _count(bounds),
        ]
    )
    figures += [
        Figure("intervals of effects hold", *_share(effects, 0.9, 0.98)),
        Figure("intervals of parameters hold", *_share(parameters, 0.9, 0.98)),
        Figure("bounds hold", *_share(bounds, 0.95, 1.0)),
        Figure("CPU, median [s]", f"{np.median([r.seconds for r in rows]):.1f}"),
        Figure("answers that were wrong", str(Counter(r.answer for r in visible if not r.right))),
    ]
    show("Nuisances of real machines, blind", figures)
    head = ["nuisance", "one effect", "two", "beyond", "none", "intervals hold", "bounds hold"]
    publish("nuisances", head, table)
    for row in table:
        print(" | ".join(row))


def _share(outcomes: Sequence[bool], least: float, most: float) -> tuple[str, str, bool]:
    share = sum(outcomes) / max(len(outcomes), 1)
    return (
        f"{share:.1%} of {len(outcomes)}",
        f"{least:.0%} to {most:.0%}",
        bool(least <= share <= most),
    )


def _count(outcomes: Sequence[bool]) -> str:
    return f"{sum(outcomes)} of {len(outcomes)}"


if __name__ == "__main__":
    main()
