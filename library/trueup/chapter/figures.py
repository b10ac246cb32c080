"""Every figure of the chapter, from a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.chapter.data import (
    DEPLOYMENT,
    DRAWS,
    DT_S,
    FAMILY,
    NOMINAL,
    PLANT,
    SHIFTED,
    ChapterData,
    draw,
    drive,
    excitation,
)
from trueup.control.loop import LoopRun, run_loop
from trueup.control.machine import Predicted
from trueup.control.planner import RandomShooting
from trueup.control.watchdog import inject_sensor_failure
from trueup.diagnose.open_loop import rollout_bound
from trueup.fit.identify import Identification, identify
from trueup.fit.randomised import fit_blind, fit_conditioned, sample_box
from trueup.fit.residual import fit_residual
from trueup.fit.score import FIRST, Scoring, rollout_errors
from trueup.gate.decision import default_gate
from trueup.gate.judge import judge, run_trial
from trueup.model.predictor import Identified, Nominal, Predictor
from trueup.monitor.detectors.quantile import QuantileRun
from trueup.monitor.residuals import Residuals, one_step_residuals
from trueup.randomise.membership import Box, membership
from trueup.randomise.randomisation import Randomisation

Array = NDArray[np.float64]
Value = float | int | str | bool
PLANNER_SEED, MONITOR_SEED = 7, 4242
TICKS = 200
REFERENCE = 0.55 * np.sin(2.0 * np.pi * 0.15 * (DT_S * np.arange(TICKS))[:, None])
DELAYS = (0, 1, 2, 3, 5, 8)
# delays in turn: what is seen comes late, irregularly and out of order
IRREGULAR = (3, 0, 5, 2, 8, 1)
HORIZONS = (1, 10, 50, 200)


@dataclass(frozen=True, slots=True)
class Table:
    """A table of figures: rows by name, and in each its columns by name."""

    title: str
    rows: Mapping[str, Mapping[str, Value]]


def run_chapter(progress: Callable[[str, float], None] = lambda _what, _share: None) -> list[Table]:
    """Every table of the chapter, unrounded."""
    progress("data and fits", 0.0)
    data = draw()
    identified, identification = identify(PLANT, [data.adaptation])
    predictors: dict[str, Predictor] = {
        "nominal": Nominal(PLANT),
        "blind": fit_blind(PLANT, data.pooled),
        "conditioned": fit_conditioned(PLANT, data.pooled, identified.parameters),
        "residual": fit_residual(PLANT, [data.adaptation])[0],
    }
    tables = [_data(data), _membership(data), _identification(identification), _stability()]
    steps: list[tuple[str, Callable[[], list[Table]]]] = [
        ("closed loop", lambda: _closed_loop(predictors)),
        ("delay sweep", lambda: [_delay_sweep(predictors)]),
        ("open loop", lambda: [_open_loop(predictors, data), _bound()]),
        ("monitor", lambda: [_monitor()]),
        ("gate", lambda: [_gate(predictors, data)]),
        ("watchdog", lambda: [_watchdog()]),
    ]
    for done, (what, make) in enumerate(steps, 1):
        progress(what, done / (len(steps) + 1))
        tables += make()
    progress("done", 1.0)
    return tables


def _data(data: ChapterData) -> Table:
    observed = sample_box(data.pooled)
    rows: dict[str, dict[str, Value]] = {
        name: {"low": low, "high": high} for name, (low, high) in observed.items()
    }
    return Table("Training plants", {"transitions": {"pooled": len(data.pooled.states)}, **rows})


def _membership(data: ChapterData) -> Table:
    family, samples = Randomisation.of(PLANT, FAMILY).box(), sample_box(data.pooled)
    plants = {"deployment": DEPLOYMENT, "shifted": SHIFTED, "(0.65, 0.5, 1.0)": (0.65, 0.5, 1.0)}
    return Table(
        "Membership",
        {
            name: {"family box": _inside(family, p), "sample box": _inside(samples, p)}
            for name, p in plants.items()
        },
    )


def _inside(box: Box, parameters: tuple[float, ...]) -> bool:
    return membership(box, dict(zip("kcb", parameters, strict=True)))["inside"] is True


def _identification(identification: Identification) -> Table:
    return Table(
        "Identification",
        {
            "deployment": {
                **identification.parameters,
                "rank": identification.rank,
                "condition": identification.condition,
            }
        },
    )


def _stability() -> Table:
    return Table(
        "Strictly stable",
        {
            name: {"stable": PLANT.is_stable(p)}
            for name, p in (("nominal", NOMINAL), ("deployment", DEPLOYMENT), ("shifted", SHIFTED))
        },
    )


def _loop(
    predictor: Predictor,
    parameters: tuple[float, ...],
    *delays: int,
    authority: float = 1.0,
    forward: bool = False,
) -> LoopRun:
    return run_loop(
        Predicted(Identified(PLANT, parameters), authority),
        RandomShooting(predictor, authority),
        REFERENCE,
        np.random.default_rng(PLANNER_SEED),
        delays=delays or (0,),
        stamped=forward,
    )


def _closed_loop(predictors: Mapping[str, Predictor]) -> list[Table]:
    regimes: dict[str, tuple[tuple[float, ...], int, float]] = {
        "nominal plant": (NOMINAL, 0, 1.0),
        "deployment plant": (DEPLOYMENT, 0, 1.0),
        "deployment + sensor delay of 3": (DEPLOYMENT, 3, 1.0),
        "deployment + u_max 0.5": (DEPLOYMENT, 0, 0.5),
    }
    runs = {
        regime: {
            name: _loop(p, setting[0], setting[1], authority=setting[2])
            for name, p in predictors.items()
        }
        for regime, setting in regimes.items()
    }
    errors = {
        regime: {name: run.tracking_error(REFERENCE) for name, run in row.items()}
        for regime, row in runs.items()
    }
    breaches = {
        regime: {name: run.breaches(PLANT) for name, run in row.items()}
        for regime, row in runs.items()
    }
    return [Table("Tracking error", errors), Table("Envelope breaches", breaches)]


def _delay_sweep(predictors: Mapping[str, Predictor]) -> Table:
    chosen = {name: predictors[name] for name in ("nominal", "blind", "residual")}
    rows: dict[str, dict[str, Value]] = {
        f"delay {d}": {
            name: _loop(p, DEPLOYMENT, d).tracking_error(REFERENCE) for name, p in chosen.items()
        }
        for d in DELAYS
    }
    rows["delays in turn"] = {
        name: _loop(p, DEPLOYMENT, *IRREGULAR).tracking_error(REFERENCE)
        for name, p in chosen.items()
    }
    for row, delays in zip(rows.values(), [*((d,) for d in DELAYS), IRREGULAR], strict=True):
        row |= {
            f"{name}, brought forward": _loop(p, DEPLOYMENT, *delays, forward=True).tracking_error(
                REFERENCE
            )
            for name, p in chosen.items()
        }
    return Table("Delay sweep", rows)


def _open_loop(predictors: Mapping[str, Predictor], data: ChapterData) -> Table:
    scoring = Scoring(HORIZONS[-1] * DT_S)
    errors = {name: rollout_errors(p, data.test, scoring)[0][0] for name, p in predictors.items()}
    return Table(
        "Open loop",
        {name: {str(h): float(row[h]) for h in HORIZONS} for name, row in errors.items()},
    )


def _bound() -> Table:
    zero, linear = rollout_bound(0.001, 1.02, 0), rollout_bound(0.001, 1.0, 50)
    return Table(
        "Rollout bound", {"no step": {"bound": zero}, "L = 1, 50 steps of 0.001": {"bound": linear}}
    )


def _monitor() -> Table:
    rng, nominal = np.random.default_rng(MONITOR_SEED), Nominal(PLANT)
    groups: list[list[Array]] = []
    for parameters in (NOMINAL, NOMINAL, SHIFTED):
        residuals = []
        for _ in range(20):
            issued = excitation(120, rng)
            states = drive(parameters, DRAWS.start_scale * rng.standard_normal(2), issued)
            residuals.append(one_step_residuals(nominal, states, issued[:, None]))
        groups.append(residuals)
    threshold = QuantileRun(float(np.quantile(np.concatenate(groups[0]), 0.99)))
    followed = threshold.follow(threshold.begin(), _one_channel(groups[2][0]))
    declared = len(groups[2][0]) if followed.alarm is None else followed.alarm
    row: dict[str, Value] = {
        "threshold": threshold.level,
        "held-out exceedance": float(
            np.mean([threshold.exceedance(_one_channel(r)) for r in groups[1]])
        ),
        "shifted exceedance": float(
            np.mean([threshold.exceedance(_one_channel(r)) for r in groups[2]])
        ),
        "first run starts at": declared - threshold.run + 1,
        "alarm declared at": declared,
    }
    return Table("Monitor", {"quantile 0.99": row})


def _one_channel(errors: Array) -> Residuals:
    """One-step errors of an episode as a monitor takes them: one channel, one window."""
    n = len(errors)
    return Residuals(
        errors[:, None],
        np.asarray(np.arange(1, n + 1) * DT_S, np.float64),
        np.ones(n) / n,
        np.zeros(n, np.int64),
        n * DT_S,
        np.zeros((1, 0, 2)),
    )


def _gate(predictors: Mapping[str, Predictor], data: ChapterData) -> Table:
    gate = replace(default_gate(PLANT.horizon_s), scoring=Scoring(PLANT.horizon_s, FIRST))
    nominal = predictors["nominal"]
    rows: dict[str, dict[str, Value]] = {}
    for name, candidate in (
        ("A", predictors["residual"]),
        ("B", fit_residual(PLANT, [data.mismatched])[0]),
    ):
        trial = run_trial(gate, candidate, nominal, [data.validation]).trial
        decision = judge(
            gate, trial, plant=PLANT.digest, candidate=name, incumbent="nominal", generation=0
        )
        rows["nominal"] = {
            "one-step": float(trial.incumbent.one_step[0]),
            "rollout mean": float(trial.incumbent.rollout[0]),
            "decision": "baseline",
        }
        rows[name] = {
            "one-step": float(trial.candidate.one_step[0]),
            "rollout mean": float(trial.candidate.rollout[0]),
            "decision": "accept" if decision.accepted else "reject",
        }
    return Table("Gate", rows)


def _watchdog() -> Table:
    failure = inject_sensor_failure(
        control_s=0.010, sensor_s=0.050, timeout_s=0.12, ticks=400, dies_at=200
    )
    row: dict[str, Value] = {
        "first trip [s]": failure.first_trip_s or float("nan"),
        "forced commands": failure.forced,
        "peak age [s]": failure.peak_age_s,
    }
    return Table("Watchdog", {"sensor stops at tick 200": row})
