"""Run a blind trial: its labels are committed in the audit log before the first diagnosis, and
opened when the job ends."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from trueup.canonical import Json
from trueup.episode.role import Role
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction, writing
from trueup_service.wiring import Parts
from trueup_worker.blind_trial import conduct
from trueup_worker.inputs import read_episodes, read_plant
from trueup_worker.progress import Progress

READING = 0.02  # of the job's time


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Returns the report.

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

    trials = int(request["trials"])
    return {
        "report": conduct(
            plant,
            episodes,
            trials,
            None,
            commit,
            lambda stage, part: progress.stage(stage, READING, 1.0)(part),
        )
    }


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: object
) -> None:
    """Has none: the result holds what was opened."""


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    return {"report": outcome["report"]}
