"""Run a recomputation: compute a decision anew from its inputs, and compare it with the record."""

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
    """Recomputes a decision, and returns where it differs from the recorded one.

    Raises BrokenChain if the recorded document is not the one that its digest names.
    """
    with reading(parts.database) as tx:
        decision = find.decision(tx, job.plant, str(job.request["decision"]))
        gate = find.gate(tx, job.plant, decision.gate).document
        registered = find.plant_digest(tx, job.plant)
    recorded: dict[str, Any] = decision.document
    if digest_of(recorded) != decision.digest:
        raise BrokenChain(
            "the decision's document is not the one that its digest names",
            decision=decision.digest,
        )
    predictors = {
        name: read_predictor(parts, job, digest) for name, digest in models(recorded).items()
    }
    episodes = read_episodes(
        parts, job, read_plant(parts, job), HELD_OUT, progress.stage("reading episodes", 0.0, 0.4)
    )
    recomputed = recompute(
        recorded, gate, predictors, episodes, registered, progress.stage("scoring", 0.4, 1.0)
    )
    differing: list[Json] = list(differences(recorded, recomputed))
    return {
        "decision": decision.digest,
        "agrees": not differing,
        "differences": differing,
        "recomputed": recomputed,
    }


def effects(
    parts: Parts, tx: object, job: JobRecord, outcome: dict[str, Any], context: object
) -> None:
    """Has none."""


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    return outcome
