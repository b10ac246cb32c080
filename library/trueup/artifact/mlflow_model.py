"""MLflow model: an artifact as the folder that MLflow's registries keep, and that its loaders and
other tools read.

    MLmodel        what MLflow reads: how to load it, what goes in and comes out, and where it comes
                   from
    artifact/      manifest.json and arrays.safetensors: the artifact itself, every byte as its
                   digest names it
    model.onnx     its step, but of a simulator of one's own

It loads as a `python_function` where trueup is installed, and as `onnx` where it is not. Source of
the format: MLflow 3, "MLflow models".
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import trueup
from trueup.artifact.model import Model, load
from trueup.artifact.onnx import to_onnx
from trueup.canonical import Json
from trueup.errors import NotExportable

ARTIFACT = "artifact"
FILE = "MLmodel"
TIME = "t_s"


@dataclass(frozen=True)
class Loaded:
    """What `mlflow.pyfunc.load_model` returns. It predicts a recording, window by window, from its
    past alone."""

    model: Model

    def predict(
        self, model_input: Any, params: Mapping[str, Any] | None = None
    ) -> NDArray[np.float64]:
        """Observations `(samples, observations)` for a table of columns: `t_s`, the commands, the
        observations as they were recorded.

        `params` may give `horizon_s` [s], at whose multiples rollouts start. Raises KeyError for a
        column that is missing.
        """
        commands, observations = self.model.commands, self.model.observations
        return self.model.predict(
            np.asarray(model_input[TIME]),
            np.column_stack([model_input[c.name] for c in commands]),
            np.column_stack([model_input[c.name] for c in observations]),
            (params or {}).get("horizon_s"),
        )


def _load_pyfunc(path: str) -> Loaded:
    """The entry point that MLflow calls with the path that its MLmodel file names as data."""
    return Loaded(load(path))


def write_mlflow_model(folder: Path, run: str | None, created: str) -> Model:
    """Make a folder with a fetched `artifact/` an MLflow model of a `run`, and return the model.
    `created` is when the artifact was made, in UTC. Raises BadArtifact."""
    model = load(folder / ARTIFACT)
    flavors: dict[str, Json] = {
        "python_function": {
            "loader_module": __name__,
            "data": ARTIFACT,
            "python_version": platform.python_version(),
        },
    }
    try:
        (folder / "model.onnx").write_bytes(to_onnx(model.predictor, model.digest))
        flavors["onnx"] = {"data": "model.onnx", "onnx_version": importlib.metadata.version("onnx")}
    except NotExportable:
        pass  # a simulator has no graph
    document: dict[str, Json] = {
        "run_id": run,
        "utc_time_created": created.replace("T", " ").removesuffix("Z"),
        "model_uuid": model.digest[:32],
        "flavors": flavors,
        "signature": _signature(model),
        "metadata": {
            "trueup": {
                "version": trueup.__version__,
                "artifact": model.digest,
                "plant": model.plant.name,
                "sha256": model.plant.digest,
            }
        },
    }
    (folder / FILE).write_text(json.dumps(document, indent=2) + "\n")  # JSON is YAML
    (folder / "requirements.txt").write_text(f"trueup=={trueup.__version__}\n")
    return model


def holds_artifact(document: Mapping[str, Any]) -> bool:
    """Whether an MLmodel document says that an artifact is in its folder."""
    flavors = document.get("flavors")
    flavor = flavors.get("python_function") if isinstance(flavors, Mapping) else None
    return (
        isinstance(flavor, Mapping)
        and flavor.get("loader_module") == __name__
        and flavor.get("data") == ARTIFACT
    )


def artifact_of(document: Mapping[str, Any]) -> object:
    """The digest that an MLmodel document gives the artifact in its folder."""
    metadata = document.get("metadata")
    ours = metadata.get("trueup") if isinstance(metadata, Mapping) else None
    return ours.get("artifact") if isinstance(ours, Mapping) else None


def _signature(model: Model) -> dict[str, Json]:
    """Columns in and out, as MLflow writes them: lists in JSON, as text."""
    after = [c.name for c in model.observations]
    into = [TIME, *(c.name for c in model.commands), *after]
    horizon = {
        "name": "horizon_s",
        "type": "double",
        "default": model.plant.horizon_s,
        "shape": None,
    }
    return {
        "inputs": json.dumps([{"type": "double", "name": name, "required": True} for name in into]),
        "outputs": json.dumps(
            [{"type": "double", "name": name, "required": True} for name in after]
        ),
        "params": json.dumps([horizon]),
    }
