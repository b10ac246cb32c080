"""Run a recomputation: a decision is made anew from its bytes, and held against what was
recorded."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json, digest_of
from trueup.episode.role import HELD_OUT
from trueup.errors import BrokenChain
from trueup.gate.recompute import differences, models, recompute
from trueup_service.actions import find
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts
from trueup_worker.inputs import read_episodes, read_plant, read_predictor
from trueup_worker.progress import Progress


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Recompute, and say where the two differ. Raises BrokenChain if the kept document is not the
    one that the digest names."""
    with reading(parts.database) as tx:
        made = find.decision(tx, job.plant, str(job.request["decision"]))
        gate, registered = (
            find.gate(tx, job.plant, made.gate).document,
            find.plant_digest(tx, job.plant),
        )
    recorded: dict[str, Any] = made.document
    if digest_of(recorded) != made.digest:
        raise BrokenChain(
            "the decision's document is not the one that its digest names", decision=made.digest
        )
    predictors = {
        name: read_predictor(parts, job, digest) for name, digest in models(recorded).items()
    }
    episodes = read_episodes(
        parts, job, read_plant(parts, job), HELD_OUT, progress.stage("reading episodes", 0.0, 0.4)
    )
    found = recompute(
        recorded, gate, predictors, episodes, registered, progress.stage("scoring", 0.4, 1.0)
    )
    wrong: list[Json] = list(differences(recorded, found))
    return {"decision": made.digest, "agrees": not wrong, "differences": wrong, "recomputed": found}


def effects(
    parts: Parts, tx: object, job: JobRecord, outcome: dict[str, Any], context: object
) -> None:
    """None beside its result."""


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """What the job answers with."""
    return outcome
