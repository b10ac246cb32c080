"""A fetched model: a folder with manifest.json and arrays.safetensors."""

from __future__ import annotations

from pathlib import Path

from trueup.artifact.artifact import Artifact, unpack
from trueup.errors import BadArtifact
from trueup.model.predictor import Predictor


def load_predictor(folder: Path, digest: str | None = None) -> Predictor:
    """The predictor in a folder, every digest held and its probe answered. Raises BadArtifact."""
    manifest, arrays = folder / "manifest.json", folder / "arrays.safetensors"
    if not manifest.is_file():
        raise BadArtifact(f"{folder} holds no manifest.json", hint="Fetch a model with `trueup fetch PLANT FOLDER`.")
    return unpack(Artifact(manifest.read_bytes(), arrays.read_bytes() if arrays.is_file() else b""), digest)
