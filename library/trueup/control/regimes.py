"""Regimes: how models track with a fixed planner when the machine is not what they believe.

    nominal            the nominal plant as declared
    shifted            what stands in for the real machine
    delayed            the same, and the controller sees each state some ticks late
    reduced_authority  the same, and the actuators give a share of their range, which the planner
                       knows

Every model gets the same references, seeds and random draws. Tracking and the envelope are two
answers: a run may track well outside, and badly inside. Stage MIL: see `closed_loop`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.control.closed_loop import CANNOT, change_ci95
from trueup.control.courses import Courses
from trueup.control.loop import LoopRun, run_loop
from trueup.control.machine import (
    STANDS_IN,
    Machine,
    Predicted,
    why_stands_in,
    with_authority,
)
from trueup.episode.layout import Channel
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor

Array = NDArray[np.float64]
NOMINAL, SHIFTED, DELAYED, REDUCED = REGIMES = (
    "nominal",
    "shifted",
    "delayed",
    "reduced_authority",
)
DIGITS = 6  # significant ones of a drawn run
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Conditions:
    """Under what models are run: which `regimes`, which `seeds`, the delay of the delayed regime
    [ticks], the share of authority of the reduced one, and the delays [ticks] of a sweep."""

    regimes: tuple[str, ...] = REGIMES
    seeds: tuple[int, ...] = (0, 1, 2, 3)
    delay_ticks: int = 3
    authority: float = 0.5
    sweep_ticks: tuple[int, ...] = ()

    def document(self) -> dict[str, Json]:
        """The conditions as JSON."""
        return {
            "regimes": list(self.regimes),
            "seeds": list(self.seeds),
            "delay_ticks": self.delay_ticks,
            "authority": self.authority,
            "sweep_ticks": list(self.sweep_ticks),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Regime:
    """One regime: on which machine, how late [ticks] its state is seen, and whether the controller
    is told so."""

    name: str
    machine: Machine
    delay: int = 0
    stamped: bool = False


@dataclass(frozen=True, slots=True)
class Runs:
    """The runs of one model in one regime: tracking errors and shares of states outside the
    envelope, `(courses x seeds,)` each, and the `first` of them."""

    errors: Array
    breaches: Array
    first: LoopRun

    def document(self, baseline: Runs, *, bounded: bool) -> dict[str, Json]:
        """Tracking and envelope apart. The change is that of paired runs against a baseline's."""
        mean = float(self.errors.mean())
        base = float(baseline.errors.mean())
        change = (mean - base) / base if base > 0.0 and isfinite(mean) else None
        ends = change_ci95(self.errors, baseline.errors)
        breaches = {
            "share": float(self.breaches.mean()),
            "runs": int((self.breaches > 0.0).sum()),
        }
        return {
            "tracking": mean if isfinite(mean) else None,
            "ran_away": int((~np.isfinite(self.errors)).sum()),
            "change": change if change is None or isfinite(change) else None,
            "change_ci95": None if ends is None else list(ends),
            "breaches": dict(breaches) if bounded else None,
        }


@dataclass(frozen=True, slots=True)
class RegimeRuns:
    """The runs that a study asks for: every model in every regime, on what stands in for the
    machine. A case is the number of a regime and the name of a model.

    Raises ValueError without models, seeds or regimes.
    """

    stand_in: tuple[str, Machine]
    models: Mapping[str, Predictor]
    courses: Courses
    conditions: Conditions

    def __post_init__(self) -> None:
        if not (self.models and self.conditions.seeds and self.regimes()[0]):
            raise ValueError("closed-loop runs need a model, a seed and a regime")

    def regimes(self) -> tuple[list[Regime], list[Regime], list[Json]]:
        """The regimes, those of the sweep of delays, and what is left out with the reason."""
        machine = self.stand_in[1]
        chosen, left_out = _regimes(machine, self.conditions)
        return chosen, list(_sweep(machine, self.conditions)), left_out

    def cases(self) -> list[tuple[int, str]]:
        """Every regime with every model."""
        chosen, swept, _ = self.regimes()
        return [(i, name) for i in range(len(chosen) + len(swept)) for name in self.models]

    def run(self, case: tuple[int, str], ended: Callable[[], None] = lambda: None) -> Runs:
        """The runs of a case. Calls `ended` after each."""
        chosen, swept, _ = self.regimes()
        number, name = case
        regime = [*chosen, *swept][number]
        return _run(regime, self.models[name], self.courses, self.conditions.seeds, ended)

    def run_all(self, progress: Progress) -> Iterator[Runs]:
        """The runs of every case, one after the other."""
        cases = self.cases()
        each = len(self.courses.frequencies_hz) * len(self.conditions.seeds)
        done = iter(range(1, each * len(cases) + 1))
        for case in cases:
            yield self.run(case, lambda: progress(next(done) / (each * len(cases))))


def run_regimes(
    stand_in: tuple[str, Machine],
    models: Mapping[str, Predictor],
    courses: Courses,
    conditions: Conditions,
    progress: Progress = lambda _: None,
) -> dict[str, Json]:
    """Every model in every regime, as the document `trueup.closedloop/1`; the first model is the
    baseline of changes. `stand_in` is the machine and the name of the model that describes it.

    Raises ValueError without models, seeds or regimes.
    """
    asked = RegimeRuns(stand_in, models, courses, conditions)
    return regimes_document(asked, asked.run_all(progress))


def regimes_document(asked: RegimeRuns, runs: Iterable[Runs]) -> dict[str, Json]:
    """The document of a study from the runs of its cases, in their order."""
    name, machine = asked.stand_in
    chosen, sweep, left_out = asked.regimes()
    by_case = dict(zip(asked.cases(), runs, strict=True))
    table, swept = (
        {r: {key: by_case[first + i, key] for key in asked.models} for i, r in enumerate(regimes)}
        for first, regimes in ((0, chosen), (len(chosen), sweep))
    )
    models, courses, conditions = asked.models, asked.courses, asked.conditions
    plant = courses.plant
    return {
        "schema": "trueup.closedloop/1",
        "plant": plant.name,
        "stage": "MIL",
        "shows": f"what each model does to a fixed planner on {STANDS_IN[machine.model.kind]}, "
        "and on variations of it",
        "cannot_show": CANNOT,
        "machine": {
            "model": name,
            "kind": machine.model.kind,
            "stands_in": STANDS_IN[machine.model.kind],
            "why": why_stands_in(machine.model.kind),
        },
        "conditions": conditions.document(),
        "reference": _reference(courses),
        "unit": _unit(plant),
        "baseline": next(iter(models)),
        "regimes": [_regime(r, runs, courses) for r, runs in table.items()],
        "left_out": left_out,
        "sweep": _sweep_rows(swept),
    }


def _regimes(machine: Machine, conditions: Conditions) -> tuple[list[Regime], list[Json]]:
    """The regimes that were asked for, and those that would show nothing, with the reason."""
    reduced = with_authority(machine, conditions.authority)
    every = {
        NOMINAL: Regime(NOMINAL, Predicted(Nominal(machine.plant))),
        SHIFTED: Regime(SHIFTED, machine),
        DELAYED: Regime(DELAYED, machine, conditions.delay_ticks),
        REDUCED: Regime(REDUCED, reduced),
    }
    asked = [every[name] for name in REGIMES if name in conditions.regimes]
    if machine.model.kind != Nominal.kind or NOMINAL not in conditions.regimes:
        return asked, []
    why = f"no shift is known: {why_stands_in(Nominal.kind)}"
    left_out: list[Json] = [{"regime": SHIFTED, "why": why}] if every[SHIFTED] in asked else []
    return [r for r in asked if r.name != SHIFTED], left_out


def _sweep(machine: Machine, conditions: Conditions) -> Iterator[Regime]:
    for delay in conditions.sweep_ticks:
        for stamped in (False, True):
            yield Regime(DELAYED, machine, delay, stamped)


def _run(
    regime: Regime,
    model: Predictor,
    courses: Courses,
    seeds: Sequence[int],
    ended: Callable[[], None],
) -> Runs:
    machine, authority = regime.machine, regime.machine.authority
    runs, errors = [], []
    for hz in courses.frequencies_hz:
        reference = courses.reference(hz)
        for seed in seeds:
            rng = np.random.default_rng(seed)
            run = run_loop(
                machine,
                courses.planner(model, authority),
                reference,
                rng,
                begin=courses.begin(rng),
                hold=courses.hold,
                delays=(regime.delay,),
                stamped=regime.stamped,
            )
            runs.append(run)
            errors.append(run.tracking_error(reference, courses.error_scale))
            ended()
    breaches = np.array([run.breaches(machine.plant) for run in runs])
    return Runs(np.array(errors), breaches, runs[0])


def _regime(regime: Regime, runs: Mapping[str, Runs], courses: Courses) -> Json:
    """One regime with every model's answers, and a run of each to draw."""
    baseline = next(iter(runs.values()))
    bounded = bool(courses.plant.envelope)
    return {
        "regime": regime.name,
        "machine": regime.machine.model.kind,
        "delay_ticks": regime.delay,
        "authority": regime.machine.authority,
        "runs": len(baseline.errors),
        "models": [
            {"model": key, **each.document(baseline, bounded=bounded), "drawn": _drawn(each.first)}
            for key, each in runs.items()
        ],
    }


def _sweep_rows(swept: Mapping[Regime, Mapping[str, Runs]]) -> list[Json]:
    """Tracking by delay, with observations taken for what is now, and with stamped ones."""
    means = {
        (r.delay, r.stamped, key): float(each.errors.mean())
        for r, runs in swept.items()
        for key, each in runs.items()
    }
    return [
        {
            "delay_ticks": delay,
            "model": key,
            "tracking": mean if isfinite(mean) else None,
            "stamped": means[delay, True, key] if isfinite(means[delay, True, key]) else None,
        }
        for (delay, stamped, key), mean in means.items()
        if not stamped
    ]


def _reference(courses: Courses) -> dict[str, Json]:
    """The references, with the first of them as it is drawn."""
    return {
        "middle": courses.middle.tolist(),
        "amplitude": courses.amplitude.tolist(),
        "frequencies_hz": list(courses.frequencies_hz),
        "ticks": courses.ticks,
        "tick_s": courses.tick_s,
        "channels": _first_channels(courses.plant),
        "drawn": _short(courses.reference(courses.frequencies_hz[0])),
    }


def _drawn(run: LoopRun) -> Json:
    """A run as it is drawn: positions after each tick, issued and applied commands."""
    joints = run.states.shape[1] // 2
    return {
        "positions": _short(run.states[1:, :joints]),
        "issued": _short(run.issued),
        "applied": _short(run.applied),
    }


def _short(columns: Array) -> Json:
    """Columns `(ticks, n)` as lists by column, with the digits that a drawing needs; null where a
    run ran away."""
    return [
        [float(f"{x:.{DIGITS}g}") if isfinite(x) else None for x in column] for column in columns.T
    ]


def _unit(plant: Plant) -> str:
    """The unit of a tracking error."""
    if len(plant.joints) > 1:
        return "squares of each joint's amplitude"
    unit = _position(plant).unit or "unit"
    return f"{unit}^2" if unit.isalpha() else f"({unit})^2"


def _position(plant: Plant) -> Channel:
    """The channel that shows the first joint's position."""
    columns = zip(plant.layout.observations, plant.state_columns, strict=True)
    return next(channel for channel, column in columns if column == 0)


def _first_channels(plant: Plant) -> dict[str, Json]:
    """The channels that are drawn: the first joint's position, and the first command."""
    shown = {"position": _position(plant), "command": plant.layout.commands[0]}
    return {what: {"name": c.name, "unit": c.unit} for what, c in shown.items()}
