"""Commands that pass versions to an MLflow registry, and take them from one."""

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
from trueup_cli.exits import HOLDS, told
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, witnessed
from trueup_cli.show import Bar, as_json, progress, say
from trueup_client import Client, DigestMismatch
from trueup_client.records import Artifact as Registered

app = App(
    name="mlflow",
    help="Pass versions to an MLflow registry, and take them from one.",
    help_epilogue=told(HOLDS),
)
Registry = Annotated[
    str | None,
    Parameter(
        env_var="MLFLOW_TRACKING_URI", help="Address of MLflow's tracking server, or sqlite:///FILE"
    ),
]
SERVING = "serving"  # the alias of what serves
MADE_HERE = "trueup.artifact"
SIGNED_IN = r"//[^\s/]*@"  # what stands before the host of an address
QUIET = {  # no telemetry, no minutes of retries, and nothing of its own on standard output
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
    """Write a version to an MLflow registry, with its numbers, its gate's figures and where it
    comes from; once for each version.

    What serves gets the alias `serving` there.
    """
    with witnessed(url) as client, _asking(registry) as mlflow, _working("export") as (bar, folder):
        serving = client.serving(plant)
        digest = artifact or serving.artifact
        client.fetch(plant, digest, folder / ARTIFACT)
        bar(0.3, "writing it there")
        there = _Version.of(mlflow, name or plant, digest)
        version = there.found() or there.create(client, plant, folder)
        if digest == serving.artifact:
            there.mark(version)
    told_ = {
        "model": f"models:/{there.name}/{version}",
        "artifact": digest,
        "serving": digest == serving.artifact,
    }
    as_json(told_) if as_json_ else say("{} is [bold]{}[/]", digest, told_["model"])


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
    """Make a candidate of an MLflow model: of the artifact that it holds, else of the plant's
    parameters among its run's params.

    All that is known there of a model that was made elsewhere stands in the candidate's provenance.
    """
    with witnessed(url) as client, _working(f"import {model}") as (_, folder):
        if Path(model).is_dir():
            known, kept = _held(Path(model))
        else:
            with _asking(registry) as mlflow:
                known, kept = _known(mlflow, model, folder)
        made = kept or _of_parameters(Plant.from_document(client.plant(plant)["document"]), known)
        version = client.add_artifact(plant, made.manifest, made.arrays)
    if as_json_:
        as_json(version)
    else:
        say("candidate [bold]{}[/], version {} of {}", version["digest"], version["version"], plant)


@contextmanager
def _asking(registry: str | None) -> Iterator[ModuleType]:
    """MLflow's own client, asking a registry. Raises MlflowRefused, NotInstalled."""
    if registry is None:
        raise MlflowRefused("no registry was named")
    os.environ.update({k: x for k, x in QUIET.items() if k not in os.environ})
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
        said = str(error).splitlines()[0].replace(registry.rstrip("/"), where(registry))
        raise MlflowRefused(f"{where(registry)}: {re.sub(SIGNED_IN, '//', said)}") from None


@contextmanager
def _working(what: str) -> Iterator[tuple[Bar, Path]]:
    """Progress, and a folder for as long as it lasts."""
    with progress(what) as bar, tempfile.TemporaryDirectory() as folder:
        yield bar, Path(folder)


def where(address: str) -> str:
    """Of a registry's address what holds no password: scheme and host, of a database or a folder
    the scheme alone."""
    parts = urlsplit(address)
    if parts.scheme not in ("http", "https"):
        return parts.scheme or "file"
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"


@dataclass(frozen=True)
class _Version:
    """An artifact as a version of a registered model."""

    mlflow: ModuleType
    asked: Any
    name: str
    digest: str

    @staticmethod
    def of(mlflow: ModuleType, name: str, digest: str) -> _Version:
        return _Version(mlflow, mlflow.MlflowClient(), name, digest)

    def found(self) -> str | None:
        """The version that holds it, if there is one."""
        found = self.asked.search_model_versions(
            f"name = '{self.name}' and tags.`{MADE_HERE}` = '{self.digest}'"
        )
        return str(found[0].version) if found else None

    def create(self, client: Client, plant: str, folder: Path) -> str:
        """Write a run with its numbers and files, and a version that came from it."""
        experiment = self.asked.get_experiment_by_name(plant)
        run = self.asked.create_run(
            experiment.experiment_id if experiment else self.asked.create_experiment(plant),
            run_name=self.digest[:12],
        )
        made, known = run.info.run_id, client.artifact(plant, self.digest)
        metrics, tags = self._told(client, known)
        ended = "FAILED"
        try:
            model = write_mlflow_model(folder, made, known["created_at"])
            for name, x in numbers(model).items():
                self.asked.log_param(made, name, x)
            for name, figure in metrics.items():
                self.asked.log_metric(made, name, figure)
            for name, tag in tags.items():
                self.asked.set_tag(made, name, tag)
            self.asked.log_artifacts(made, str(folder), "model")
            ended = "FINISHED"
        finally:
            self.asked.set_terminated(made, ended)
        if not self.asked.search_registered_models(f"name = '{self.name}'"):
            self.asked.create_registered_model(
                self.name, description=f"The dynamics model of {plant}, kept and judged by trueup"
            )
        source = f"{run.info.artifact_uri}/model"
        return str(self.asked.create_model_version(self.name, source, made, tags=tags).version)

    def mark(self, version: str) -> None:
        """Let the alias of what serves stand at a version."""
        self.asked.set_registered_model_alias(self.name, SERVING, version)

    def _told(self, client: Client, known: Registered) -> tuple[dict[str, float], dict[str, str]]:
        """Figures and tags of the newest decision on it."""
        tags = {
            MADE_HERE: self.digest,
            "trueup.plant": known["plant"],
            "trueup.version": str(known["version"]),
        }
        decision = next(
            (d for d in client.decisions(known["plant"]) if d["candidate"] == self.digest), None
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
    """A predictor's numbers under the names that MLflow takes: the plant's parameters as they are
    called, an effect's after it."""
    described: Any = model.predictor.description()
    plant, kind = model.plant, model.predictor.kind
    found = described.get("parameters") or {}
    if kind == Nominal.kind:
        found = dict(zip(plant.dynamics.parameter_names, plant.parameters, strict=True))
    told = {key(name): x for name, x in found.items()}
    for effect in described.get("effects") or ():
        place = "/".join(key(part) for part in (effect["effect"], effect["joint"]) if part)
        told |= {f"{place}/{key(name)}": x for name, x in effect["parameters"].items()}
    return told | {"kind": kind}


def key(name: str) -> str:
    """A name in the letters that MLflow takes: another letter is its number between colons, so that
    no two names become one."""
    return re.sub(r"[^A-Za-z0-9_.-]", lambda found: f":{ord(found[0]):x}:", name)


def _known(
    mlflow: ModuleType, model: str, folder: Path
) -> tuple[dict[str, JsonValue], Artifact | None]:
    """What an MLflow model's file, its version and its run say of it, and the artifact in it."""
    version = _version(mlflow, model)
    uri = f"models:/{version.name}/{version.version}"
    mlflow.artifacts.download_artifacts(f"{uri}/{FILE}", dst_path=str(folder))
    if holds_artifact(_read(folder / FILE)):
        mlflow.artifacts.download_artifacts(f"{uri}/{ARTIFACT}", dst_path=str(folder))
    known, kept = _held(folder)
    registered = (version.tags or {}).get(MADE_HERE)
    if kept is not None and registered not in (None, kept.digest):
        raise DigestMismatch(
            f"{uri} is registered as {registered[:12]} and holds {kept.digest[:12]}"
        )
    return {
        **known,
        "source": uri,
        "registry": where(mlflow.get_registry_uri()),
        **_of_version(mlflow, version),
    }, kept


def _held(folder: Path) -> tuple[dict[str, JsonValue], Artifact | None]:
    """What an MLflow model's file says of it, and the artifact in its folder. Raises NotImportable,
    DigestMismatch."""
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
    kept, told = (
        Artifact(manifest.read_bytes(), arrays.read_bytes() if arrays.is_file() else b""),
        artifact_of(document),
    )
    if told != kept.digest:
        raise DigestMismatch(f"{FILE} names artifact {str(told)[:12]} and holds {kept.digest[:12]}")
    return known, kept


def _version(mlflow: ModuleType, model: str) -> Any:
    named = re.fullmatch(r"models:/([^/@]+)(?:/(\d+)|@([^/@]+))", model)
    if named is None:
        raise NotImportable(
            f"{model!r} names no version of a model",
            hint="Give models:/NAME/VERSION, models:/NAME@ALIAS, or a folder.",
        )
    name, number, alias = named.groups()
    asked = mlflow.MlflowClient()
    return (
        asked.get_model_version(name, number)
        if number
        else asked.get_model_version_by_alias(name, alias)
    )


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
    """An MLmodel document, which is YAML."""
    import yaml

    try:
        document = json.loads(
            json.dumps(yaml.safe_load(file.read_text()), default=str)
        )  # YAML has dates, JSON has none
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


def _of_parameters(plant: Plant, known: Mapping[str, JsonValue]) -> Artifact:
    """The plant's form with the numbers that a run had as params. Raises NotImportable."""
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
