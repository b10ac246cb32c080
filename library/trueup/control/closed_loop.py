"""Closed loop: does a better prediction track better?

A fixed planner drives a simulated machine with one model and with another. Both runs have the same
machine, references and random draws; they differ in the model that the planner rolls out. Stage
MIL: the figures show what the models do to this planner on this simulated machine. They show
nothing of hardware, of computing time, or of what the simulated machine leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from trueup.bootstrap import interval
from trueup.canonical import Json
from trueup.control.courses import Courses
from trueup.control.loop import run_loop
from trueup.control.machine import Machine, words_of
from trueup.model.predictor import Predictor

Array = NDArray[np.float64]
SEEDS = 4
RESAMPLES = 1000
CANNOT = (
    "hardware, the time that a controller's computer takes, and whatever the simulated "
    "machine leaves out"
)


@dataclass(frozen=True)
class Tracking:
    """Tracking errors of paired runs `(scenarios x seeds,)` with a candidate and with the
    incumbent, breaches' shares, and the kind of model that stands in for the machine.

    An error is a mean square, of a robot in squares of each joint's `amplitude` `(joints,)`.
    """

    candidate: Array
    incumbent: Array
    breaches: tuple[float, float]
    amplitude: tuple[float, ...]
    machine: str = "corrected"

    def change_ci95(self) -> tuple[float, float] | None:
        """The bootstrap interval of the paired difference over runs, relative to the incumbent's
        mean; None where runs ran away."""
        return change_ci95(self.candidate, self.incumbent)

    def document(self) -> dict[str, Json]:
        """Both means, the paired difference relative to the incumbent's with a bootstrap interval,
        breaches, and what the figures can show."""
        base = max(float(self.incumbent.mean()), 1e-300)
        numbers = {
            "candidate": float(self.candidate.mean()),
            "incumbent": float(self.incumbent.mean()),
            "change": float((self.candidate - self.incumbent).mean() / base),
        }
        finite: dict[str, Json] = {name: x if isfinite(x) else None for name, x in numbers.items()}
        return {
            "stage": "MIL",
            "runs": len(self.candidate),
            "amplitude": self.amplitude[0] if len(self.amplitude) == 1 else list(self.amplitude),
            **finite,
            "change_ci95": None if (change := self.change_ci95()) is None else list(change),
            "breaches": {"candidate": self.breaches[0], "incumbent": self.breaches[1]},
            "shows": f"what either model does to the fixed planner on {words_of(self.machine)}",
            "cannot_show": CANNOT,
        }


def change_ci95(candidate: Array, incumbent: Array) -> tuple[float, float] | None:
    """The 95 % bootstrap interval of the difference of paired runs `(runs,)`, relative to the
    incumbent's mean; None where runs ran away, or there are few."""
    base = max(float(incumbent.mean()), 1e-300)
    with np.errstate(invalid="ignore"):  # both may have run away
        difference = candidate - incumbent
    return interval(
        [difference],
        lambda more, axis: more.mean(axis=axis) / base,
        RESAMPLES,
        np.random.default_rng(0),
    )


@dataclass(frozen=True, slots=True)
class Driven:
    """The runs of one model: tracking errors and shares of states outside the envelope, `(courses x
    seeds,)` each."""

    errors: Array
    breaches: Array


def drive(
    machine: Machine,
    model: Predictor,
    courses: Courses,
    ended: Callable[[], None] = lambda: None,
) -> Driven:
    """Runs of one model on a machine, SEEDS of each course. Calls `ended` after each."""
    errors, breaches = [], []
    for hz in courses.frequencies_hz:
        reference = courses.reference(hz)
        for seed in range(SEEDS):
            rng = np.random.default_rng(seed)
            begin, planner = courses.begin(rng), courses.planner(model)
            run = run_loop(machine, planner, reference, rng, begin=begin, hold=courses.hold)
            errors.append(run.tracking_error(reference, courses.error_scale))
            breaches.append(run.breaches(machine.plant))
            ended()
    return Driven(np.array(errors), np.array(breaches))


def tracking_of(
    machine: Machine, courses: Courses, candidate: Driven, incumbent: Driven
) -> Tracking:
    """The tracking of two models whose runs are paired."""
    return Tracking(
        candidate.errors,
        incumbent.errors,
        (float(candidate.breaches.mean()), float(incumbent.breaches.mean())),
        tuple(map(float, courses.amplitude)),
        machine.model.kind,
    )


def compare(
    machine: Machine,
    candidate: Predictor,
    incumbent: Predictor,
    courses: Courses,
    progress: Callable[[float], None] = lambda _: None,
) -> Tracking:
    """Paired runs of both models on a machine, SEEDS of each course."""
    total = len(courses.frequencies_hz) * SEEDS * 2
    done = iter(range(1, total + 1))
    by_candidate, by_incumbent = (
        drive(machine, model, courses, lambda: progress(next(done) / total))
        for model in (candidate, incumbent)
    )
    return tracking_of(machine, courses, by_candidate, by_incumbent)
