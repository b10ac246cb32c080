"""Run a calibration: healthy episodes become the monitor of what serves."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json, digest_of
from trueup.episode.role import HEALTHY
from trueup.monitor.monitor import calibrate
from trueup_service.actions.add_monitor import add_monitor
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction
from trueup_service.wiring import Parts
from trueup_worker.cycle import cycle_of
from trueup_worker.inputs import read_episodes, read_plant, read_predictor
from trueup_worker.progress import Progress

READING = 0.2  # of the job's time


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Calibrates. Repeating it gives the same monitor."""
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    predictor = read_predictor(parts, job, request["artifact"])
    episodes = read_episodes(
        parts, job, plant, HEALTHY, progress.stage("reading episodes", 0.0, READING)
    )
    monitor = calibrate(
        predictor,
        request["artifact"],
        episodes,
        float(request["promise_h"]),
        int(request["seed"]),
        request.get("detectors") or (),
        lambda stage, part: progress.stage(stage, READING, 1.0)(part),
    )
    return {
        "monitor": monitor.document(),
        "kept": {name: list(state) for name, state in monitor.begin().items()},
    }


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Adds the monitor, which watches from the time of the job's submission."""
    add_monitor(tx, job.plant, outcome["monitor"], outcome["kept"], job.id, job.created_at, context)
    cycle_of(parts, tx, context).go_on(job.plant)


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    document = outcome["monitor"]
    return {
        "monitor": digest_of(document),
        "promise_h": document["promise_h"],
        "figures": document["figures"],
    }
