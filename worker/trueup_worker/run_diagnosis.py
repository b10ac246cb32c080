"""Run a diagnosis: adaptation and validation episodes become a report and a corrected model, which
is a candidate like any other."""

from __future__ import annotations

from typing import Any

from trueup.artifact.artifact import Artifact, pack
from trueup.canonical import Json, canonical_bytes, digest_of, digest_of_bytes
from trueup.code_identity import code_identity
from trueup.collect.coverage import coverage_of
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.figures import FIGURES_FILE, figures
from trueup.diagnose.processes import in_processes
from trueup.diagnose.report import COMMAND_FILE
from trueup.diagnose.summary_text import sentence
from trueup.episode.role import Role
from trueup.randomise.supported import RANDOMISATION_FILE, supported_ranges
from trueup_service.actions.add_artifact import add_artifact
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction
from trueup_service.wiring import Parts
from trueup_worker.cycle import cycle_of
from trueup_worker.inputs import read_episodes, read_plant, sources
from trueup_worker.outputs import add_files, keep_arrays, keep_file
from trueup_worker.progress import Progress

READING = 0.1  # of the job's time


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Diagnoses, stores the arrays, and returns the manifest and the report.

    Repeating it gives the same bytes.
    """
    plant = read_plant(parts, job)
    roles = Role.ADAPTATION, Role.VALIDATION
    episodes = read_episodes(
        parts, job, plant, roles, progress.stage("reading episodes", 0.0, READING)
    )
    request: dict[str, Any] = dict(job.request)
    seed = int(request["seed"])
    diagnosis = diagnose(
        plant,
        episodes,
        seed,
        lambda stage, part: progress.stage(stage, READING, 1.0)(part),
        in_processes,
    )
    report = dict(diagnosis.document)
    provenance: dict[str, Json] = {
        "origin": "diagnosis",
        "episodes": sources(episodes),
        "coverage": [
            c.document()
            for c in coverage_of(plant, [e for e in episodes if e.role is Role.ADAPTATION])
        ],
        "configuration": {"sha256": digest_of(job.request), "document": job.request},
        "code": code_identity(),
        "seed": seed,
        "parent": job.request["parent"],
        "report": {
            "sha256": digest_of(report),
            "verdict": report["verdict"],
            "sentence": sentence(report),
        },
    }
    artifact = pack(diagnosis.predictor, provenance)
    drawn = canonical_bytes(figures(diagnosis))
    files = [keep_file(parts, FIGURES_FILE, "application/json", drawn)]
    ranges = supported_ranges(diagnosis.predictor, report)
    if ranges is not None:
        content = canonical_bytes(ranges)
        files.append(keep_file(parts, RANDOMISATION_FILE, "application/json", content))
    experiment = diagnosis.experiment
    if experiment is not None and experiment.command is not None:
        files.append(keep_file(parts, COMMAND_FILE, "text/csv", experiment.csv(plant).encode()))
    return {
        "manifest": artifact.manifest.decode(),
        "arrays": keep_arrays(parts, artifact),
        "report": report,
        "files": list(files),
    }


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Adds the corrected model as the plant's next version, and judges it if a policy says so."""
    add_files(tx, job, outcome.get("files", ()))
    artifact = Artifact(outcome["manifest"].encode(), b"")
    add_artifact(tx, job.plant, artifact, job.id, context)
    cycle_of(parts, tx, context).diagnosed(job, artifact.digest, outcome["report"]["verdict"])


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    return {"artifact": digest_of_bytes(outcome["manifest"].encode()), "report": outcome["report"]}
