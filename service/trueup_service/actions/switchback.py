"""The switchback test: whether the artifact that is to serve again can serve."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from threading import BoundedSemaphore
from time import perf_counter
from typing import Any

from trueup.artifact.artifact import Artifact, unpack
from trueup.artifact.session import session_state
from trueup.canonical import Json
from trueup.code_identity import code_identity, library_versions
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode_stream
from trueup.errors import TrueupError
from trueup.fit.score import Scoring, score
from trueup.gate.decision import Gate
from trueup.model.predictor import Predictor
from trueup_service.actions.add_artifact import require_plant
from trueup_service.errors import SwitchbackFailed
from trueup_service.registry.blobs import Blobs
from trueup_service.registry.records import ArtifactRecord

AT_ONCE = BoundedSemaphore(2)  # tests: each reads two models and a recording
HELD: dict[str, Json] = {
    "loads": True,
    "digests_hold": True,
    "answers_probe": True,
    "fits_plant": True,
}


def load_artifact(blobs: Blobs, record: ArtifactRecord) -> Artifact:
    """An artifact with its bytes from the blob store. Raises BlobMissing."""
    return Artifact(
        record.manifest.encode(), b"" if record.arrays is None else blobs.get(record.arrays)
    )


def rehearse_rollback(blobs: Blobs, record: ArtifactRecord, plant_digest: str) -> dict[str, Json]:
    """The record of a switchback test that passed: the artifact loads, its digests hold, it answers
    its recorded probe, and it was made for the plant as it is; and what the switch is compatible
    with. Raises SwitchbackFailed."""
    with AT_ONCE:
        predictor = _able(blobs, record, plant_digest)
    return {**HELD, "artifact": record.digest, **_compatibility(record, predictor)}


def _compatibility(record: ArtifactRecord, predictor: Predictor) -> dict[str, Json]:
    """What a switch to an artifact was tried with: the code and libraries that loaded it and those
    that made it, and the session state of a controller that runs it."""
    provenance: Any = json.loads(record.manifest).get("provenance") or {}
    made_by: Json = provenance.get("code") if isinstance(provenance, Mapping) else None
    return {
        "loaded_by": code_identity(),
        "made_by": made_by,
        "libraries": library_versions(),
        "session": session_state(predictor),
    }


def _able(blobs: Blobs, record: ArtifactRecord, plant_digest: str) -> Predictor:
    """The predictor of an artifact that can serve. Raises SwitchbackFailed."""
    try:
        artifact = load_artifact(blobs, record)
        predictor = unpack(artifact, record.digest)
        require_plant(artifact, plant_digest)
    except TrueupError as error:
        raise SwitchbackFailed(
            f"version {record.version} cannot serve: {error.message}",
            cause=error.code,
            artifact=record.digest,
        ) from error
    return predictor


def rehearse(
    blobs: Blobs,
    back: ArtifactRecord,
    plant_digest: str,
    candidate: Predictor,
    probe: Episode,
    scoring: Scoring,
    now: str,
) -> dict[str, Json]:
    """Rehearse the way back before a promotion: what serves now is loaded again, and scored beside
    the candidate on a probe episode.

    The record says when, how long loading took [s], and the rollout errors of both. Raises
    SwitchbackFailed.
    """
    began = perf_counter()
    predictor = _able(blobs, back, plant_digest)
    seconds = perf_counter() - began
    both = {"back": predictor, "forward": candidate}
    scored = {name: float(score(p, [probe], scoring).rollout[0]) for name, p in both.items()}
    return {
        **HELD,
        "artifact": back.digest,
        **_compatibility(back, predictor),
        "at": now,
        "seconds": seconds,
        "probe": probe.digest,
        "rollout_error": {name: x if isfinite(x) else None for name, x in scored.items()},
    }


def rehearse_decision(
    blobs: Blobs,
    spool: Path,
    back: ArtifactRecord,
    candidate: ArtifactRecord,
    plant_digest: str,
    decision: Mapping[str, Any],
    gate: Mapping[str, Any],
    now: str,
) -> dict[str, Json]:
    """Rehearse the way back from the candidate of a decision, on the decision's first episode.
    Raises SwitchbackFailed."""
    with AT_ONCE, blobs.local_copy(decision["episodes"][0], spool) as path, path.open("rb") as file:
        forward = unpack(load_artifact(blobs, candidate), candidate.digest)
        probe = read_episode_stream(file, path.stat().st_size, forward.plant.layout)
        return rehearse(
            blobs, back, plant_digest, forward, probe, Gate.from_document(gate).scoring, now
        )
