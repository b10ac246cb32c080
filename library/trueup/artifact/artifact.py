"""Artifact: a predictor as data, named by the SHA-256 of its manifest.

The manifest is canonical JSON and names the arrays file (safetensors) by digest; so one digest
names every byte. Nothing in it can be executed. `probe` holds inputs with the outputs that the
predictor gave when it was made, so loading can check that it still gives them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from trueup.artifact.arrays import arrays_from_bytes, arrays_to_bytes
from trueup.canonical import Json, canonical_bytes, digest_of_bytes
from trueup.errors import BadArtifact, TrueupError
from trueup.model.kinds import KINDS
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor

Array = NDArray[np.float64]
SCHEMA = "trueup.artifact/1"
PROBES = 8
# relative: matrix products differ by some 1e-13 between processors and their libraries
PROBE_TOLERANCE = 1e-9
MANIFEST_BYTES = 4 << 20


@dataclass(frozen=True)
class Artifact:
    """Manifest and arrays as bytes; `arrays` is empty for a predictor without any."""

    manifest: bytes
    arrays: bytes

    @staticmethod
    def of(manifest: bytes, arrays: Callable[[Mapping[str, Json]], bytes]) -> Artifact:
        """An artifact by its manifest and a function that fetches the arrays which its document
        names. Raises BadArtifact."""
        document = read_manifest(manifest)
        artifact = Artifact(manifest, arrays(document))
        artifact.__dict__["document"] = document  # what the cached property would read again
        return artifact

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the manifest: the artifact's name."""
        return digest_of_bytes(self.manifest)

    @cached_property
    def document(self) -> Mapping[str, Json]:
        """The manifest as JSON. Raises BadArtifact."""
        return read_manifest(self.manifest)


def read_manifest(manifest: bytes) -> Mapping[str, Json]:
    """The manifest's document, in canonical form and complete. Raises BadArtifact."""
    if len(manifest) > MANIFEST_BYTES:
        raise BadArtifact(f"the manifest has {len(manifest)} bytes, {MANIFEST_BYTES} are allowed")
    try:
        document = orjson.loads(manifest)
        canonical = canonical_bytes(document) == manifest
    except (orjson.JSONDecodeError, TrueupError, RecursionError) as error:
        raise BadArtifact(f"the manifest is no canonical JSON: {error}") from error
    if not canonical or not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise BadArtifact(f"the manifest is no canonical {SCHEMA} document")
    return document


def pack(predictor: Predictor, provenance: Mapping[str, Json]) -> Artifact:
    """A predictor and its provenance, as data. Equal predictors with equal provenance give equal
    bytes."""
    arrays = arrays_to_bytes(predictor.arrays())
    document: dict[str, Json] = {
        "schema": SCHEMA,
        "kind": predictor.kind,
        "plant": {
            "name": predictor.plant.name,
            "sha256": predictor.plant.digest,
            "document": predictor.plant.document,
        },
        "predictor": predictor.description(),
        "arrays": {"sha256": digest_of_bytes(arrays), "bytes": len(arrays)} if arrays else None,
        "probe": _probe(predictor),
        "provenance": dict(provenance),
    }
    return Artifact(canonical_bytes(document), arrays)


def unpack(artifact: Artifact, digest: str | None = None) -> Predictor:
    """The predictor of an artifact, after every digest and its probe were checked. Raises
    BadArtifact, BadPlant."""
    if digest is not None and artifact.digest != digest:
        raise BadArtifact(
            "the manifest is not the one that this digest names",
            expected=digest,
            found=artifact.digest,
        )
    document: Any = artifact.document
    try:
        _require_arrays(document["arrays"], artifact.arrays)
        plant = _plant(orjson.dumps(document["plant"]["document"]))
        predictor = KINDS[str(document["kind"])].restore(
            plant, document["predictor"], arrays_from_bytes(artifact.arrays)
        )
        answered = _answers(predictor, document["probe"])
        named = document["plant"]["sha256"]
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise BadArtifact(f"the manifest does not describe a predictor: {error!r}") from error
    if plant.digest != named:
        raise BadArtifact("the plant in the manifest is not the one that its digest names")
    if not answered:
        raise BadArtifact(
            "the predictor does not give the recorded outputs for the recorded inputs"
        )
    return predictor


@lru_cache(maxsize=256)
def _plant(document: bytes) -> Plant:
    """The plant of a manifest; many versions of a model share one."""
    return Plant.from_document(orjson.loads(document))


def _require_arrays(declared: Any, arrays: bytes) -> None:
    expected = None if declared is None else declared["sha256"]
    digest = digest_of_bytes(arrays) if arrays else None
    if expected != digest:
        raise BadArtifact(
            "the arrays are not those that the manifest names", expected=expected, found=digest
        )


def _probe(predictor: Predictor) -> dict[str, Json]:
    """States spread over the declared scales and commands over their limits, and where the
    predictor moves them."""
    plant = predictor.plant
    rng = np.random.default_rng(0)
    states = np.zeros((PROBES, 2 * plant.dynamics.joints))
    states[:, plant.state_columns] = (
        rng.uniform(-1.0, 1.0, (PROBES, len(plant.scales))) * plant.scales
    )
    low, high = plant.limits
    issued = rng.uniform(low, high, (PROBES, len(low)))
    after = predictor.predict_batch(states, issued)
    return {"states": states.tolist(), "issued": issued.tolist(), "after": after.tolist()}


def _answers(predictor: Predictor, probe: Mapping[str, Json]) -> bool:
    states, issued, after = (np.array(probe[key], float) for key in ("states", "issued", "after"))
    answers = predictor.predict_batch(states, issued)
    return answers.shape == after.shape and bool(
        np.allclose(
            answers, after, rtol=PROBE_TOLERANCE, atol=PROBE_TOLERANCE * float(np.abs(after).max())
        )
    )


def nominal_artifact(plant: Plant) -> Artifact:
    """The plant's declared model as an artifact: it serves until a candidate is promoted."""
    return pack(Nominal(plant), {"origin": "registration"})
