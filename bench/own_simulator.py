"""A simulator of one's own beside the compiled family of the same law: the verdicts, and the time.

`CASES=FOLDER` names a folder of case folders, `FIRST=N` how many of them are taken, spread over
all; without, the machines are drawn by the second simulator. Both are diagnosed one after the other
in one process.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class Timed:
    """What a diagnosis says, by which scheme it explains the log, and the CPU time and the time [s]
    that it took."""

    said: str
    scheme: Scheme
    cpu_s: float
    time_s: float

    @staticmethod
    def of(plant: Plant, episodes: Sequence[Episode]) -> Timed:
        """Diagnose, and look at both clocks."""
        cpu_s, time_s = time.process_time(), time.perf_counter()
        diagnosis = diagnose(plant, episodes)
        spent = time.process_time() - cpu_s, time.perf_counter() - time_s
        return Timed(answer(diagnosis), diagnosis.search.problem.scheme, *spent)


@dataclass(frozen=True)
class Compared:
    """A machine that was diagnosed with a compiled model and with a simulator of one's own."""

    name: str
    compiled: Timed
    own: Timed

    @property
    def by_cpu(self) -> float:
        """How many times the CPU time the simulator took."""
        return self.own.cpu_s / self.compiled.cpu_s

    @property
    def by_time(self) -> float:
        """How many times as long the simulator took."""
        return self.own.time_s / self.compiled.time_s

    def told(self) -> Compared:
        """Print it while others are still diagnosed."""
        first, second = self.compiled, self.own
        print(
            f"{self.name}: {first.said} | {second.said}, "
            f"CPU {first.cpu_s:.1f} s and {second.cpu_s:.1f} s, "
            f"time {first.time_s:.1f} s and {second.time_s:.1f} s",
            flush=True,
        )
        return self


def show_compared(title: str, machines: Sequence[Compared]) -> None:
    """Print what was compared."""
    same = [m.compiled.said == m.own.said for m in machines]
    rows = [
        Figure(
            f"{m.name}: {m.compiled.said}",
            f"{m.by_cpu:.1f} x CPU, {m.by_time:.1f} x time",
            m.own.said,
            is_same,
        )
        for m, is_same in zip(machines, same, strict=True)
    ]
    rows.append(Figure("the same answer", f"{sum(same)} of {len(same)}", "all", all(same)))
    by_cpu, by_time = [m.by_cpu for m in machines], [m.by_time for m in machines]
    for what, ratio in (
        ("CPU, own / compiled, median", median(by_cpu)),
        ("the same, largest", max(by_cpu)),
        ("time, own / compiled, median", median(by_time)),
        ("the same, largest", max(by_time)),
    ):
        rows.append(Figure(what, f"{ratio:.1f}", f"{WANTED:.0f}", ratio <= WANTED))
    show(title, rows)


def compared(name: str, plant: Plant, episodes: Sequence[Episode]) -> Compared:
    """A machine diagnosed with its family and with the same law as a simulator."""
    compiled = Timed.of(plant, episodes)
    own = as_simulator(plant, compiled.scheme)
    by_own = Timed.of(own, [replace(e, layout=own.layout) for e in episodes])
    return Compared(name, compiled, by_own).told()


def main() -> None:
    """Diagnose each machine with both."""
    show_compared("Own-simulator", [compared(*case) for case in cases()])
