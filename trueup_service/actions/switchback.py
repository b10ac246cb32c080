"""The switchback test: would the artifact that is to serve again really serve?"""

from __future__ import annotations

from trueup.artifact.artifact import Artifact, unpack
from trueup.canonical import Json
from trueup.errors import TrueupError
from trueup_service.actions.add_artifact import require_plant
from trueup_service.errors import SwitchbackFailed
from trueup_service.registry.blobs import Blobs
from trueup_service.registry.records import ArtifactRecord


def load_artifact(blobs: Blobs, record: ArtifactRecord) -> Artifact:
    """An artifact's bytes, as they are kept."""
    return Artifact(record.manifest.encode(), b"" if record.arrays is None else blobs.get(record.arrays))


def test_switchback(blobs: Blobs, record: ArtifactRecord, plant_digest: str) -> dict[str, Json]:
    """What held: it loads, its digests hold, it answers its recorded probe, it was made for the plant as it is. Raises SwitchbackFailed."""
    try:
        artifact = load_artifact(blobs, record)
        unpack(artifact, record.digest)
        require_plant(artifact, plant_digest)
    except TrueupError as error:
        raise SwitchbackFailed(
            f"version {record.version} cannot serve: {error.message}", cause=error.code, artifact=record.digest
        ) from error
    return {"artifact": record.digest, "loads": True, "digests_hold": True, "answers_probe": True, "fits_plant": True}
