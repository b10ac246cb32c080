"""Run a validation: score the model that serves on episodes held out since its promotion.

It has become worse if its error is above that on the episodes of its promotion.
"""

from __future__ import annotations

import uuid
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.bootstrap import interval
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
from trueup_worker.exact_numbers import from_json, to_json
from trueup_worker.inputs import read_episodes, read_plant, read_predictor
from trueup_worker.progress import Progress
from trueup_worker.spread import Spread

WORSE = 1.25  # ratio to the error at promotion, at the lower end of its interval
RESAMPLES = 1000
LEAST = 1e-300  # of an error, to divide by
AT_ONCE = 64  # episodes: about a second, beside the tenths that a part takes to be taken

Array = NDArray[np.float64]


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Scores what serves on the episodes of its promotion and on those since, in the same way.
    Where there are many, parts of the job score AT_ONCE of them each."""
    request: dict[str, Any] = job.request
    digests = list(request["episodes"])
    asked = [{"episodes": digests[i : i + AT_ONCE]} for i in range(0, len(digests), AT_ONCE)]
    progress.stage("scoring", 0.0, 1.0)
    if len(asked) == 1:
        answers = [part(parts, job, asked[0])]
    else:
        with Spread(parts.queue, job.id) as spread:
            answers = list(spread(asked, progress))
    errors = np.concatenate([from_json(answer["errors"]) for answer in answers])
    cells = [tuple(cell) for answer in answers for cell in answer["cells"]]
    new = np.array([digest in request["new"] for digest in digests])
    both = {c for c, n in zip(cells, new, strict=True) if n} & {
        c for c, n in zip(cells, new, strict=True) if not n
    }
    # only conditions that occur before and since: the error of another task says nothing
    comparable = np.array([c in both for c in cells]) if both else np.ones(len(cells), np.bool_)
    before, now = errors[~new & comparable], errors[new & comparable]
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


def part(parts: Parts, job: JobRecord, asked: dict[str, Any]) -> Any:
    """Scores some of the episodes, and says in which cell of conditions each is."""
    request: dict[str, Any] = job.request
    plant, predictor = read_plant(parts, job), read_predictor(parts, job, request["artifact"])
    episodes = read_episodes(parts, job, plant, HELD_OUT, lambda _: None, asked["episodes"])
    errors = score(predictor, episodes, Scoring(plant.horizon_s, EVERY)).rollout
    return {"errors": to_json(errors), "cells": cells_of(episodes, request["conditions"])}


def _compared(before: Array, now: Array) -> dict[str, Json]:
    """Mean errors, their ratio with a bootstrap interval over episodes, and whether the model is
    worse even at the lower end of the interval. With few episodes there is no interval, and the
    model is not called worse."""
    errors: dict[str, Json] = {
        "episodes": len(now),
        "error": float(now.mean()) if np.isfinite(now).all() else None,
        "error_before": float(before.mean()) if len(before) and np.isfinite(before).all() else None,
    }
    if errors["error"] is None or not errors["error_before"]:
        diverges = errors["error"] is None
        return {**errors, "ratio": None, "ratio_ci95": None, "worse": diverges}
    ends = interval([now, before], _ratio, RESAMPLES, np.random.default_rng(0))
    return {
        **errors,
        "ratio": float(now.mean() / before.mean()),
        "ratio_ci95": None if ends is None else list(ends),
        "worse": ends is not None and ends[0] > WORSE,
    }


def _ratio(now: Array, before: Array, axis: int) -> Array:
    return np.asarray(now.mean(axis=axis) / np.maximum(before.mean(axis=axis), LEAST))


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Raises an alarm, as a monitor does, if the model has become worse."""
    validation = outcome["validation"]
    if validation["worse"] and find.serving(tx, job.plant).artifact == outcome["artifact"]:
        tx.plants.lock(job.plant)
        ratio = validation["ratio"]
        words = (
            "the model runs away"
            if ratio is None
            else f"held-out episodes are predicted {ratio:.2g} times as badly as at its promotion"
        )
        document = {
            "detectors": {"scheduled_validation": {"at_s": 0.0, "leading": words}},
            "since": outcome["first"],
            "since_ns": outcome["since_ns"],
            "episodes": validation["episodes"],
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
    """Returns the result of the job."""
    return {"artifact": outcome["artifact"], **outcome["validation"]}
