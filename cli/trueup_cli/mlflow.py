"""Commands that export versions to an MLflow registry, and import them from one."""

from __future__ import annotations

import importlib
import json
import math
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any
from urllib.parse import urlsplit

from cyclopts import App, Parameter

from trueup.artifact.artifact import Artifact, pack
from trueup.artifact.mlflow_model import (
    ARTIFACT,
    FILE,
    artifact_of,
    holds_artifact,
    write_mlflow_model,
)
from trueup.artifact.model import Model
from trueup.canonical import Json as JsonValue
from trueup.errors import MlflowRefused, NotImportable, NotInstalled
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal
from trueup_cli.exits import VERIFIES, exit_codes
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect_witnessed
from trueup_cli.show import Bar, as_json, progress, say
from trueup_client import Client, DigestMismatch
from trueup_client.records import Artifact as Registered

app = App(
    name="mlflow",
    help="Export versions to an MLflow registry, or import them from one.",
    help_epilogue=exit_codes(VERIFIES),
)
Registry = Annotated[
    str | None,
    Parameter(
        env_var="MLFLOW_TRACKING_URI", help="Address of MLflow's tracking server, or sqlite:///FILE"
    ),
]
SERVING = "serving"  # the alias of what serves
DIGEST_TAG = "trueup.artifact"
CREDENTIALS = r"//[^\s/]*@"  # what stands before the host of an address
ENVIRONMENT = {  # no telemetry, no long retries, and no output of MLflow's own
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_LOGGING_LEVEL": "WARNING",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
}


@app.command
def export(
    plant: PlantName,
    *,
    artifact: Annotated[str | None, Parameter(help="Digest; default: what serves")] = None,
    name: Annotated[
        str | None, Parameter(help="Registered model; default: the plant's name")
    ] = None,
    registry: Registry = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Export a version to an MLflow registry, with its numbers, figures and provenance.

    A version that is there already is not written again. What serves gets the alias `serving`.
    """
    with (
        connect_witnessed(url) as client,
        _mlflow_at(registry) as mlflow,
        _working("export") as (bar, folder),
    ):
        serving = client.serving(plant)
        digest = artifact or serving.artifact
        client.fetch(plant, digest, folder / ARTIFACT)
        bar(0.3, "writing it there")
        exported = _ExportedVersion.of(mlflow, name or plant, digest)
        version = exported.existing() or exported.create(client, plant, folder)
        if digest == serving.artifact:
            exported.mark_serving(version)
    address = f"models:/{exported.name}/{version}"
    if as_json_:
        as_json({"model": address, "artifact": digest, "serving": digest == serving.artifact})
    else:
        say("{} is [bold]{}[/]", digest, address)


@app.command(name="import")
def import_(
    model: Annotated[
        str,
        Parameter(
            help="models:/NAME/VERSION, models:/NAME@ALIAS, or a folder that an export wrote"
        ),
    ],
    plant: PlantName,
    *,
    registry: Registry = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Import an MLflow model as a candidate.

    It is the artifact that the model holds, or else the plant's parameters among its run's params.
    What MLflow knows of a model that was made elsewhere is written to the candidate's provenance.
    """
    with connect_witnessed(url) as client, _working(f"import {model}") as (_, folder):
        if Path(model).is_dir():
            known, artifact = _read_folder(Path(model))
        else:
            with _mlflow_at(registry) as mlflow:
                known, artifact = _download(mlflow, model, folder)
        if artifact is None:
            declared = Plant.from_document(client.plant(plant)["document"])
            artifact = _artifact_of_parameters(declared, known)
        version = client.add_artifact(plant, artifact.manifest, artifact.arrays)
    if as_json_:
        as_json(version)
    else:
        say("candidate [bold]{}[/], version {} of {}", version["digest"], version["version"], plant)


@contextmanager
def _mlflow_at(registry: str | None) -> Iterator[ModuleType]:
    """Yields the mlflow module, set up for a registry. Raises MlflowRefused, NotInstalled."""
    if registry is None:
        raise MlflowRefused("no registry was named")
    os.environ.update({k: x for k, x in ENVIRONMENT.items() if k not in os.environ})
    try:
        mlflow = importlib.import_module("mlflow")
    except ImportError as error:
        raise NotInstalled(
            "an MLflow registry is asked by MLflow's own client",
            hint="Install it with `pip install 'trueup[mlflow]'`.",
        ) from error
    mlflow.set_tracking_uri(registry)
    mlflow.set_registry_uri(registry)
    try:
        yield mlflow
    except Exception as error:
        if not isinstance(error, mlflow.MlflowException) and not type(error).__module__.startswith(
            "sqlalchemy"
        ):
            raise
        shown = without_credentials(registry)
        message = str(error).splitlines()[0].replace(registry.rstrip("/"), shown)
        raise MlflowRefused(f"{shown}: {re.sub(CREDENTIALS, '//', message)}") from None


@contextmanager
def _working(what: str) -> Iterator[tuple[Bar, Path]]:
    """Yields a progress bar and a temporary folder."""
    with progress(what) as bar, tempfile.TemporaryDirectory() as folder:
        yield bar, Path(folder)


def without_credentials(address: str) -> str:
    """Returns the scheme and host of a registry; for a database or a folder the scheme alone."""
    parts = urlsplit(address)
    if parts.scheme not in ("http", "https"):
        return parts.scheme or "file"
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"


@dataclass(frozen=True)
class _ExportedVersion:
    """An artifact as a version of a registered model of MLflow."""

    registry: Any
    name: str
    digest: str

    @staticmethod
    def of(mlflow: ModuleType, name: str, digest: str) -> _ExportedVersion:
        """Names an artifact in the registry that MLflow is set up for."""
        return _ExportedVersion(mlflow.MlflowClient(), name, digest)

    def existing(self) -> str | None:
        """Returns the version that holds the artifact; None if there is none."""
        versions = self.registry.search_model_versions(
            f"name = '{self.name}' and tags.`{DIGEST_TAG}` = '{self.digest}'"
        )
        return str(versions[0].version) if versions else None

    def create(self, client: Client, plant: str, folder: Path) -> str:
        """Writes a run with numbers and files, and a version made from it, which it returns."""
        experiment = self.registry.get_experiment_by_name(plant)
        run = self.registry.create_run(
            experiment.experiment_id if experiment else self.registry.create_experiment(plant),
            run_name=self.digest[:12],
        )
        run_id, record = run.info.run_id, client.artifact(plant, self.digest)
        metrics, tags = self._metrics_and_tags(client, record)
        status = "FAILED"
        try:
            model = write_mlflow_model(folder, run_id, record["created_at"])
            for name, value in numbers(model).items():
                self.registry.log_param(run_id, name, value)
            for name, figure in metrics.items():
                self.registry.log_metric(run_id, name, figure)
            for name, tag in tags.items():
                self.registry.set_tag(run_id, name, tag)
            self.registry.log_artifacts(run_id, str(folder), "model")
            status = "FINISHED"
        finally:
            self.registry.set_terminated(run_id, status)
        if not self.registry.search_registered_models(f"name = '{self.name}'"):
            self.registry.create_registered_model(
                self.name, description=f"The dynamics model of {plant}, kept and judged by trueup"
            )
        source = f"{run.info.artifact_uri}/model"
        return str(self.registry.create_model_version(self.name, source, run_id, tags=tags).version)

    def mark_serving(self, version: str) -> None:
        """Moves the alias of what serves to a version."""
        self.registry.set_registered_model_alias(self.name, SERVING, version)

    def _metrics_and_tags(
        self, client: Client, record: Registered
    ) -> tuple[dict[str, float], dict[str, str]]:
        """Returns the figures of the newest decision on the artifact, and the version's tags."""
        tags = {
            DIGEST_TAG: self.digest,
            "trueup.plant": record["plant"],
            "trueup.version": str(record["version"]),
        }
        decision = next(
            (d for d in client.decisions(record["plant"]) if d["candidate"] == self.digest), None
        )
        if decision is None:
            return {}, tags
        verdicts = decision["document"]["verdicts"]
        figures = {
            f"gate.{v['rule']}.{key}": v[key]
            for v in verdicts
            for key in ("value", "threshold")
            if v[key] is not None
        }
        return figures, tags | {
            "trueup.decision": decision["digest"],
            "trueup.accepted": str(decision["accepted"]).lower(),
        }


def numbers(model: Model) -> dict[str, float | str]:
    """Returns a predictor's numbers under names that MLflow accepts.

    A parameter of the plant has its own name, a parameter of an effect that of the effect and its
    own.
    """
    described: Any = model.predictor.description()
    plant, kind = model.plant, model.predictor.kind
    parameters = described.get("parameters") or {}
    if kind == Nominal.kind:
        parameters = dict(zip(plant.dynamics.parameter_names, plant.parameters, strict=True))
    named = {key(name): value for name, value in parameters.items()}
    for effect in described.get("effects") or ():
        place = "/".join(key(part) for part in (effect["effect"], effect["joint"]) if part)
        named |= {f"{place}/{key(name)}": value for name, value in effect["parameters"].items()}
    return named | {"kind": kind}


def key(name: str) -> str:
    """Returns a name in the letters that MLflow accepts.

    Any other letter becomes its code point between colons, so that no two names become one.
    """
    return re.sub(r"[^A-Za-z0-9_.-]", lambda match: f":{ord(match[0]):x}:", name)


def _download(
    mlflow: ModuleType, model: str, folder: Path
) -> tuple[dict[str, JsonValue], Artifact | None]:
    """Returns what MLflow knows of a model, and the artifact in it, if any.

    Raises DigestMismatch.
    """
    version = _version(mlflow, model)
    uri = f"models:/{version.name}/{version.version}"
    mlflow.artifacts.download_artifacts(f"{uri}/{FILE}", dst_path=str(folder))
    if holds_artifact(_read(folder / FILE)):
        mlflow.artifacts.download_artifacts(f"{uri}/{ARTIFACT}", dst_path=str(folder))
    known, artifact = _read_folder(folder)
    registered = (version.tags or {}).get(DIGEST_TAG)
    if artifact is not None and registered not in (None, artifact.digest):
        raise DigestMismatch(
            f"{uri} is registered as {registered[:12]} and holds {artifact.digest[:12]}"
        )
    return {
        **known,
        "source": uri,
        "registry": without_credentials(mlflow.get_registry_uri()),
        **_of_version(mlflow, version),
    }, artifact


def _read_folder(folder: Path) -> tuple[dict[str, JsonValue], Artifact | None]:
    """Returns what a model's MLmodel file says, and the artifact in its folder, if any.

    Raises NotImportable, DigestMismatch.
    """
    document = _read(folder / FILE)
    known: dict[str, JsonValue] = {
        "flavors": sorted(map(str, document.get("flavors", ()))),
        "created": str(document.get("utc_time_created")),
        "signature": document.get("signature"),
        "metadata": document.get("metadata"),
    }
    if not holds_artifact(document):
        return known, None
    manifest, arrays = (
        folder / ARTIFACT / name for name in ("manifest.json", "arrays.safetensors")
    )
    if not manifest.is_file():
        raise NotImportable(
            f"{FILE} names an artifact, and there is none", hint="Export the version again."
        )
    artifact = Artifact(manifest.read_bytes(), arrays.read_bytes() if arrays.is_file() else b"")
    named = artifact_of(document)
    if named != artifact.digest:
        raise DigestMismatch(
            f"{FILE} names artifact {str(named)[:12]} and holds {artifact.digest[:12]}"
        )
    return known, artifact


def _version(mlflow: ModuleType, model: str) -> Any:
    match = re.fullmatch(r"models:/([^/@]+)(?:/(\d+)|@([^/@]+))", model)
    if match is None:
        raise NotImportable(
            f"{model!r} names no version of a model",
            hint="Give models:/NAME/VERSION, models:/NAME@ALIAS, or a folder.",
        )
    name, number, alias = match.groups()
    registry = mlflow.MlflowClient()
    if number:
        return registry.get_model_version(name, number)
    return registry.get_model_version_by_alias(name, alias)


def _of_version(mlflow: ModuleType, version: Any) -> dict[str, JsonValue]:
    run = mlflow.MlflowClient().get_run(version.run_id).data if version.run_id else None
    return {
        "run": version.run_id,
        "description": version.description,
        "aliases": [str(a) for a in version.aliases or ()],
        "tags": dict(version.tags or {}),
        "params": dict(run.params) if run else {},
        "metrics": {name: x if math.isfinite(x) else None for name, x in run.metrics.items()}
        if run
        else {},
    }


def _read(file: Path) -> Mapping[str, Any]:
    """Returns an MLmodel document, which is YAML. Raises NotImportable."""
    import yaml

    try:
        # through JSON, which has no dates
        document = json.loads(json.dumps(yaml.safe_load(file.read_text()), default=str))
    except (OSError, ValueError, TypeError, RecursionError, yaml.YAMLError) as error:
        raise NotImportable(
            f"{file} is no MLmodel file: {error}",
            hint="Name the folder that MLflow wrote, or its version.",
        ) from error
    if not isinstance(document, dict) or not isinstance(document.get("flavors", {}), dict):
        raise NotImportable(
            f"{file} is no MLmodel file", hint="Name the folder that MLflow wrote, or its version."
        )
    return document


def _artifact_of_parameters(plant: Plant, known: Mapping[str, JsonValue]) -> Artifact:
    """Packs the plant's form with the params of a run as its numbers. Raises NotImportable."""
    params: Any = known.get("params") or {}
    names = plant.dynamics.parameter_names
    missing = [name for name in names if key(name) not in params]
    if missing:
        raise NotImportable(
            f"nothing is told of its {', '.join(missing)}", missing=missing, found=sorted(params)
        )
    try:
        values = tuple(float(params[key(name)]) for name in names)
    except ValueError as error:
        raise NotImportable(f"its run's params are no numbers: {error}") from error
    if not all(map(math.isfinite, values)):
        raise NotImportable("its run's params are not all finite numbers")
    return pack(Identified(plant, values), {"origin": "mlflow", "mlflow": dict(known)})
