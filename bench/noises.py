"""Diagnoses under noise that is not white: the machines of the second simulator, each with its
noise remade.

Every effect of the catalogue once (but those that are counted in the samples), and machines with
none, on linear joints, pendulums and axes in a loop. The machine, its commands and the noise's size
are the same in each row; correlation and tails differ. An answer is right as in a blind trial.
`EVERY=2` takes one machine in two; `PUBLISH=1` keeps the table for the pages.
"""

from __future__ import annotations

import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from bench.report import Figure, publish, show
from tests.support.simulated import episodes_of, plant_of
from trueup.blindtrial.scoring import Answer, score_answer
from trueup.diagnose.diagnosis import diagnose
from trueup.fit.fitter import warm
from trueup.simulate.noise import NoiseModel
from trueup.simulate.trial import CATALOGUE, draw, draw_bench

LAWS = {
    "white": NoiseModel(),
    "AR(0.5)": NoiseModel(0.5),
    "AR(0.7)": NoiseModel(0.7),
    "AR(0.9)": NoiseModel(0.9),
    "t with 3": NoiseModel(0.0, 3.0),
    "AR(0.9), t with 4": NoiseModel(0.9, 4.0),
    "AR(0.5), t with 3": NoiseModel(0.5, 3.0),
}
COUNTED = ("sensor_quantization", "dropped_frames")
# nothing shows them on a bare inertia
NO_SPRING = "sensor_bias", "sensor_drift", "k_modulated", "asymmetric_stiffness"
TIERS = ("A1", "B1", "B2")
NONE = 12
SEED = 20280
EVERY = int(os.environ.get("EVERY", "1"))


@dataclass(frozen=True)
class Row:
    """What one machine's diagnosis answered: whether right or abstained, which intervals of
    parameters hold the truth, and CPU seconds."""

    law: str
    name: str
    right: bool
    abstained: bool
    held: tuple[bool, ...]
    seconds: float


def main() -> None:
    names = [*([n] for n in CATALOGUE if n not in COUNTED), *([] for _ in range(NONE))]
    wanted = [(law, i, n) for law in LAWS for i, n in enumerate(names) if i % EVERY == 0]
    with ProcessPoolExecutor(
        len(os.sched_getaffinity(0)), initializer=warm
    ) as pool:  # compiling is no row's
        rows = []
        for row in pool.map(_row, *zip(*wanted, strict=True)):
            rows.append(row)
            print(
                f"{len(rows)} of {len(wanted)}: {row.law}, {row.name}",
                end="\r",
                file=sys.stderr,
                flush=True,
            )
    white = _share(rows, "white")
    figures, table = [], []
    for law in LAWS:
        mine = [r for r in rows if r.law == law]
        held = [x for r in mine for x in r.held]
        share = sum(held) / max(len(held), 1)
        covers = 0.9 <= share <= 0.98
        seconds = sum(r.seconds for r in mine) / sum(r.seconds for r in rows if r.law == "white")
        figures += [
            Figure(
                f"{law}: right",
                f"{sum(r.right for r in mine)} of {len(mine)}",
                "within 0.02 of white",
                _share(rows, law) >= white - 0.02,
            ),
            Figure("  abstained", str(sum(r.abstained for r in mine))),
            Figure(
                "  intervals that hold the truth",
                f"{share:.3f} of {len(held)}",
                "0.90 to 0.98",
                covers,
            ),
            Figure("  times white's CPU", f"{seconds:.2f}"),
            *(
                Figure(f"    missed: {r.name}", "abstains" if r.abstained else "another answer")
                for r in mine
                if not r.right
            ),
        ]
        told = (
            f"{sum(r.right for r in mine)} of {len(mine)}",
            str(sum(r.abstained for r in mine)),
            f"{share:.3f} of {len(held)}",
        )
        table.append([law, *told[:2], told[2] if covers else f"**{told[2]}**", f"{seconds:.1f}"])
    show("noises: right under noise that is not white", figures)
    publish(
        "noises",
        ["noise", "right", "abstained", "intervals that hold the truth", "CPU, white's being 1"],
        table,
    )


def _share(rows: list[Row], law: str) -> float:
    return float(np.mean([r.right for r in rows if r.law == law]))


def _row(law: str, i: int, names: list[str]) -> Row:
    rng = np.random.default_rng(SEED + i)
    tier = TIERS[i % 3] if not set(names) & set(NO_SPRING) else TIERS[i % 2]
    trial = draw(bench := replace(draw_bench(tier, rng), law=LAWS[law]), names, True, rng)
    plant, began = plant_of(bench), time.process_time()
    found = dict(diagnose(plant, episodes_of(plant, trial)).document)
    took = time.process_time() - began
    label = {
        "kind": "single" if names else "none",
        "effects": {n: {} for n in names},
        "moved": True,
        "bait": None,
    }
    right = bool(score_answer(label, Answer(found, None, took))["exact"])
    m, told = trial.machine, found["parameters"]
    truth = {"k": m.k, "c": m.c, "b": m.b}
    held = (
        tuple(bool(p["ci95"][0] <= truth[n] <= p["ci95"][1]) for n, p in told.items())
        if right
        else ()
    )
    return Row(
        law,
        f"{tier} {', '.join(names) or 'none'}",
        right,
        found["verdict"] == "unknown_effect",
        held,
        took,
    )
