"""Run a validation without any alarm: is what serves as right on what was held out since as it was
when it was promoted?"""

from __future__ import annotations

import uuid
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.role import HELD_OUT
from trueup.fit.score import EVERY, Scoring, score
from trueup.gate.cells import cells_of
from trueup_service.actions import find
from trueup_service.actions.alarms import raise_alarm
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction, reading
from trueup_service.wiring import Parts
from trueup_worker.cycle import cycle_of
from trueup_worker.inputs import read_episodes, read_plant, read_predictor
from trueup_worker.progress import Progress

WORSE = 1.25  # times the error at promotion, at the lower end of the interval
RESAMPLES = 1000
READING = 0.5  # of the job's time

Array = NDArray[np.float64]


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Score what serves on the episodes of its promotion and on those that came since, with the
    same rollouts."""
    request: dict[str, Any] = job.request
    plant, predictor = read_plant(parts, job), read_predictor(parts, job, request["artifact"])
    episodes = read_episodes(
        parts, job, plant, HELD_OUT, progress.stage("reading episodes", 0.0, READING)
    )
    progress.stage("scoring", READING, 1.0)
    scoring = Scoring(plant.horizon_s, EVERY)
    errors = score(predictor, episodes, scoring).rollout
    new = np.array([e.digest in request["new"] for e in episodes])
    cells = cells_of(episodes, request["conditions"])
    both = {c for c, n in zip(cells, new, strict=True) if n} & {
        c for c, n in zip(cells, new, strict=True) if not n
    }
    alike = (
        np.array([c in both for c in cells]) if both else np.ones(len(cells), np.bool_)
    )  # another task is no worse model
    before, now = errors[~new & alike], errors[new & alike]
    with reading(parts.database) as tx:
        first = min(
            (find.episode(tx, job.plant, d) for d in request["new"]),
            key=lambda e: e.start_ns,
        )
    return {
        "validation": _compared(before, now),
        "artifact": request["artifact"],
        "first": first.digest,
        "since_ns": str(first.start_ns),
    }


def _compared(before: Array, now: Array) -> dict[str, Json]:
    """Mean errors, their ratio with a bootstrap interval over episodes, and whether it is worse."""
    rng = np.random.default_rng(0)
    found: dict[str, Json] = {
        "episodes": len(now),
        "error": float(now.mean()) if np.isfinite(now).all() else None,
        "error_before": float(before.mean()) if len(before) and np.isfinite(before).all() else None,
    }
    if found["error"] is None or not found["error_before"]:
        return {
            **found,
            "ratio": None,
            "ratio_ci95": None,
            "worse": found["error"] is None,
        }  # what runs away is worse than anything
    drawn = [x[rng.integers(0, len(x), (RESAMPLES, len(x)))].mean(axis=1) for x in (now, before)]
    ratios = drawn[0] / np.maximum(drawn[1], 1e-300)
    low, high = (float(np.quantile(ratios, q)) for q in (0.025, 0.975))
    return {
        **found,
        "ratio": float(now.mean() / before.mean()),
        "ratio_ci95": [low, high],
        "worse": low > WORSE,
    }


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Worse is an alarm like a monitor's."""
    found = outcome["validation"]
    if found["worse"] and find.serving(tx, job.plant).artifact == outcome["artifact"]:
        tx.plants.lock(job.plant)
        ratio = found["ratio"]
        words = (
            "the model runs away"
            if ratio is None
            else f"held-out episodes are predicted {ratio:.2g} times as badly as at its promotion"
        )
        document = {
            "detectors": {"scheduled_validation": {"at_s": 0.0, "leading": words}},
            "since": outcome["first"],
            "since_ns": outcome["since_ns"],
            "episodes": found["episodes"],
            "change": {"words": [words]},
        }
        raise_alarm(
            tx,
            uuid.uuid4().hex,
            job.plant,
            None,
            outcome["artifact"],
            {"episode": outcome["first"], "document": document},
            context,
        )
        cycle_of(parts, tx, context).go_on(job.plant)


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """What the job answers with."""
    return {"artifact": outcome["artifact"], **outcome["validation"]}
