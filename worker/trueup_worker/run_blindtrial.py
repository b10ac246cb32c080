"""Run a blind trial: its labels are committed in the audit log before the first diagnosis, and
opened when the job ends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from trueup.blindtrial.conduct import DRAWING
from trueup.canonical import Json
from trueup.episode.role import Role
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction, writing
from trueup_service.wiring import Parts
from trueup_worker.blind_trial import conduct
from trueup_worker.inputs import read_episodes, read_plant
from trueup_worker.progress import Progress
from trueup_worker.spread import Spread
from trueup_worker.trial_case import keep_case, read_answer

READING = 0.02  # of the job's time


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Returns the report. Each case is a part of the job, which any worker may diagnose.

    Repeating it draws and commits anew. An auditor sees every commitment, and which one was opened.
    """
    plant = read_plant(parts, job)
    episodes = read_episodes(
        parts,
        job,
        plant,
        (Role.ADAPTATION, Role.VALIDATION),
        progress.stage("reading episodes", 0.0, READING),
    )
    request: dict[str, Any] = dict(job.request)

    def commit(commitments: list[str]) -> None:
        with writing(parts.database) as tx:
            tx.log.append(
                ActorContext(job.created_by, time_text(datetime.now(UTC))),
                "blindtrial:committed",
                plant=job.plant,
                subject=job.id,
                facts={"operation": job.operation, "commitments": commitments},
            )

    def shown(stage: str, share: float) -> None:
        progress.stage(stage, READING, 1.0)(share)

    with Spread(parts.queue, job.id) as spread:

        def diagnose_all(folders: Sequence[Path]) -> Iterator[Mapping[str, Any]]:
            cases = [keep_case(parts, folder) for folder in folders]
            answers = spread(
                cases, lambda done: shown("diagnosing", DRAWING + (1.0 - DRAWING) * done)
            )
            return map(partial(read_answer, parts), answers)

        report = conduct(plant, episodes, int(request["trials"]), None, commit, shown, diagnose_all)
    return {"report": report}


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: object
) -> None:
    """Has none: the result holds what was opened."""


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    return {"report": outcome["report"]}
