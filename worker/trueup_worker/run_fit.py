"""Run a fit: adaptation episodes become a candidate artifact with its provenance."""

from __future__ import annotations

from typing import Any

from trueup.artifact.artifact import Artifact, pack
from trueup.canonical import Json, digest_of, digest_of_bytes
from trueup.collect.coverage import coverage_of
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.fit.identify import identify
from trueup.fit.residual import RIDGE, fit_residual
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup_service.actions.add_artifact import add_artifact
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction
from trueup_service.wiring import Parts
from trueup_worker.code_identity import code_identity
from trueup_worker.inputs import read_episodes, read_plant, sources
from trueup_worker.outputs import keep_arrays
from trueup_worker.progress import Progress

SEED = 0  # both methods are deterministic; every provenance names a seed


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Fits, stores the arrays, and returns the manifest and the report.

    Repeating it gives the same bytes.
    """
    plant = read_plant(parts, job)
    episodes = read_episodes(
        parts, job, plant, (Role.ADAPTATION,), progress.stage("reading episodes", 0.0, 0.5)
    )
    predictor, report = _fit(plant, episodes, job.request, progress.stage("fitting", 0.5, 0.95))
    progress.stage("packing", 0.95, 1.0)
    artifact = pack(predictor, _provenance(job, plant, episodes, report))
    return {
        "manifest": artifact.manifest.decode(),
        "arrays": keep_arrays(parts, artifact),
        "report": report,
    }


def _fit(
    plant: Plant, episodes: list[Episode], request: dict[str, Any], progress: Progress
) -> tuple[Predictor, dict[str, Json]]:
    if request["method"] == "identify":
        identified, report = identify(plant, episodes, progress)
        return identified, {"method": "identify", **report.document()}
    residual, residual_report = fit_residual(
        plant,
        episodes,
        tuple(request.get("features") or ()),
        request.get("penalty") or RIDGE,
        progress,
    )
    return residual, {"method": "residual", **residual_report.document()}


def _provenance(
    job: JobRecord, plant: Plant, episodes: list[Episode], report: dict[str, Json]
) -> dict[str, Json]:
    return {
        "origin": "fit",
        "episodes": sources(episodes),
        "coverage": [c.document() for c in coverage_of(plant, episodes)],
        "configuration": {"sha256": digest_of(job.request), "document": job.request},
        "code": code_identity(),
        "seed": SEED,
        "parent": job.request["parent"],
        "report": report,
    }


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Adds the candidate as the plant's next version."""
    add_artifact(tx, job.plant, Artifact(outcome["manifest"].encode(), b""), job.id, context)


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    return {"artifact": digest_of_bytes(outcome["manifest"].encode()), "fit": outcome["report"]}
