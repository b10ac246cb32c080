"""A simulator of one's own beside the compiled family of the same law: the verdicts, and the time.

`CASES=FOLDER` names a folder of case folders, `FIRST=N` how many of them are taken, spread over
all; without, the machines are drawn by the second simulator. Both are diagnosed one after the other
in one process.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np

from bench.diagnosis import machines
from bench.report import Figure, show
from trueup.diagnose.case import read_case
from trueup.diagnose.diagnosis import Diagnosis, diagnose
from trueup.diagnose.summary_text import composition
from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.model.series import Scheme
from trueup.model.simulator.simulator import offer

WANTED = 20.0  # times as long at most
FIRST = 20


def leapfrog(back):  # type: ignore[no-untyped-def]
    """A joint with a force that pulls it back, by the leapfrog method: what a user would write."""

    def step(state, command, parameters, force, h_s):  # type: ignore[no-untyped-def]
        p, u, f = parameters, command[:, 0], force[:, 0]
        q = state[:, 0] + 0.5 * h_s * state[:, 1]
        driven = p["b"] * u + f - back(q, p)
        v = state[:, 1] + 0.5 * h_s * (driven - p["c"] * state[:, 1])
        after = state[:, 1] + h_s * (driven - p["c"] * v)
        return np.column_stack([q + 0.5 * h_s * after, after])

    return step


def euler(back):  # type: ignore[no-untyped-def]
    """The same by the method that plant.json declares, semi-implicit Euler's."""

    def step(state, command, parameters, force, h_s):  # type: ignore[no-untyped-def]
        p, u, f = parameters, command[:, 0], force[:, 0]
        q, v = state[:, 0], state[:, 1]
        after = v + h_s * (p["b"] * u + f - p["c"] * v - back(q, p))
        return np.column_stack([q + h_s * after, after])

    return step


BACK = {
    "oscillator": lambda q, p: p["k"] * q,
    "pendulum": lambda q, p: p["k"] * np.sin(q),
    "inertia": lambda q, p: 0.0,
}


def as_simulator(plant: Plant, scheme: Scheme) -> Plant:
    """The plant with a simulator of its own in place of its family, which integrates as explains
    the log: by the declared method, or accurately."""
    step = (leapfrog if scheme.alpha else euler)(BACK[plant.family])
    nominal = {
        "simulator": plant.family,
        "sha256": offer(step),
        "parameters": dict(plant.nominal),
        "timestep_s": plant.timestep_s,
    }
    return Plant.from_document({**plant.document, "nominal": nominal})


def cases() -> list[tuple[str, Plant, Sequence[Episode]]]:
    """The machines of which nobody is told what acts in them."""
    first = int(os.environ.get("FIRST", FIRST))
    if "CASES" in os.environ:
        folders = sorted(p for p in Path(os.environ["CASES"]).iterdir() if p.is_dir())
        spread = folders[:: max(1, len(folders) // first)][:first]
        return [(p.name, *read_case(p)) for p in spread]
    return [(m.name, m.plant, m.episodes) for m in machines()[:first]]  # type: ignore[misc]


def answer(diagnosis: Diagnosis) -> str:
    """What a diagnosis says, in a word."""
    verdict = str(diagnosis.document["verdict"])
    return composition(diagnosis.document["effects"]) if verdict == "effect" else verdict


def main() -> None:
    """Diagnose each machine with both."""
    same, ratios, rows = 0, [], []
    for name, plant, episodes in cases():
        seconds = [time.process_time()]
        compiled = diagnose(plant, episodes)
        seconds.append(time.process_time())
        own = as_simulator(plant, compiled.search.problem.scheme)
        by_own = diagnose(own, [replace(e, layout=own.layout) for e in episodes])
        seconds = [b - a for a, b in pairwise([*seconds, time.process_time()])]
        answers = answer(compiled), answer(by_own)
        same += answers[0] == answers[1]
        ratios.append(seconds[1] / seconds[0])
        rows.append(
            Figure(
                f"{name}: {answers[0]}", f"{ratios[-1]:.1f} x", answers[1], answers[0] == answers[1]
            )
        )
        print(
            f"{name}: {answers[0]} | {answers[1]}, {seconds[0]:.1f} s and {seconds[1]:.1f} s",
            flush=True,
        )
    total = len(ratios)
    rows.append(Figure("the same answer", f"{same} of {total}", "all", same == total))
    rows.append(
        Figure(
            "CPU time, own / compiled, median",
            f"{median(ratios):.1f}",
            f"{WANTED:.0f}",
            median(ratios) <= WANTED,
        )
    )
    rows.append(
        Figure("the same, largest", f"{max(ratios):.1f}", f"{WANTED:.0f}", max(ratios) <= WANTED)
    )
    show("Own-simulator", rows)
