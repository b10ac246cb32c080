"""Run a randomisation: plants are drawn and simulated, and both predictors of their family become
candidates."""

from __future__ import annotations

from typing import Any

import orjson

from trueup.artifact.artifact import Artifact, pack
from trueup.canonical import Json, digest_of, digest_of_bytes
from trueup.code_identity import code_identity
from trueup.episode.role import Role
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.study import Randomised, randomise
from trueup.randomise.supported import RANDOMISATION_FILE
from trueup.randomise.training import Draws
from trueup_service.actions import find
from trueup_service.actions.add_artifact import add_artifact
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction, reading
from trueup_service.wiring import Parts
from trueup_worker.inputs import context_of, read_episodes, read_plant, sources
from trueup_worker.outputs import add_files, keep_arrays, keep_report
from trueup_worker.progress import Progress


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Draws, simulates and fits, stores the arrays, and returns both manifests and the report.

    Repeating it gives the same bytes.
    """
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    adaptation = read_episodes(
        parts, job, plant, (Role.ADAPTATION,), progress.stage("reading episodes", 0.0, 0.1)
    )
    family = Randomisation.of(plant, _family(parts, request))
    draws = Draws(request["plants"], request["steps"], request["start_scale"])

    def staged(stage: str, share: float) -> None:
        progress.stage(stage, *((0.1, 0.7) if stage == "simulating" else (0.7, 1.0)))(share)

    randomised, _ = randomise(
        family, draws, request["seed"], context_of(request), adaptation, staged
    )
    models = {"blind": randomised.blind, "conditioned": randomised.conditioned}
    packed = {
        name: pack(model, _provenance(job, randomised, sources(adaptation)))
        for name, model in models.items()
    }
    document = {
        **randomised.document,
        "artifacts": {name: artifact.digest for name, artifact in packed.items()},
    }
    return {
        "manifests": [artifact.manifest.decode() for artifact in packed.values()],
        "arrays": [keep_arrays(parts, artifact) for artifact in packed.values()],
        **keep_report(parts, document),
    }


def _family(parts: Parts, request: dict[str, Any]) -> Json:
    """The family that the request declares, or the ranges that its diagnosis supports."""
    if "randomisation" in request:
        return request["randomisation"]  # type: ignore[no-any-return]
    with reading(parts.database) as tx:
        output = find.output(tx, request["diagnosis"], RANDOMISATION_FILE)
    return orjson.loads(parts.blobs.get(output.digest))  # type: ignore[no-any-return]


def _provenance(job: JobRecord, randomised: Randomised, episodes: list[Json]) -> dict[str, Json]:
    document = randomised.document
    return {
        "origin": "randomisation",
        "episodes": episodes,
        "randomisation": {
            name: document[name]
            for name in ("randomisation", "draws", "family_box", "sample_box", "context")
        },
        "configuration": {"sha256": digest_of(job.request), "document": job.request},
        "code": code_identity(),
        "seed": job.request["seed"],
        "parent": job.request["parent"],
        "report": {"sha256": digest_of(document), "rows": document["rows"]},
    }


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Adds the report as a file, and both predictors as the plant's next versions."""
    add_files(tx, job, outcome["files"])
    for manifest in outcome["manifests"]:
        add_artifact(tx, job.plant, Artifact(manifest.encode(), b""), job.id, context)


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    digests = [digest_of_bytes(manifest.encode()) for manifest in outcome["manifests"]]
    return {
        "blind": digests[0],
        "conditioned": digests[1],
        "report": outcome["report"],
    }
