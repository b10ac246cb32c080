"""What the studies of models share: which models are run, what stands in for the machine, and where
the report goes."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup.artifact.model import load
from trueup.control.machine import stand_in
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import BadArtifact, NotIdentifiable
from trueup.fit.identify import identify
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor
from trueup_cli.options import connect
from trueup_cli.registry import resolve_artifact, run_job
from trueup_cli.show import as_json, say
from trueup_client import Client

Models = Annotated[
    tuple[str, ...],
    Parameter(
        help="Folder of a fetched or diagnosed model, NAME=FOLDER to name it; of a plant on "
        "the service a version, or the first digits of its digest. Give it again for more"
    ),
]
NOMINAL, IDENTIFIED = "nominal", "identified"
REPORT = "report.json"


def is_case(target: str) -> bool:
    """Whether a target is a case folder, and not the name of a plant."""
    return (Path(target) / "plant.json").is_file()


def local_models(
    plant: Plant, episodes: Sequence[Episode], named: Sequence[str]
) -> dict[str, Predictor]:
    """The nominal model, the models in the named folders, and the nominal form with identified
    parameters where adaptation episodes determine them. Raises BadArtifact."""
    models: dict[str, Predictor] = {NOMINAL: Nominal(plant)}
    for folder in named:
        name, _, path = folder.rpartition("=")
        models[name or Path(path).resolve().name] = load_model(plant, Path(path))
    adaptation = [e for e in episodes if e.role is Role.ADAPTATION]
    if adaptation:
        with suppress(NotIdentifiable):  # a study without it is still one
            models[IDENTIFIED] = identify(plant, adaptation)[0]
    return models


def local_machine(
    plant: Plant, models: Mapping[str, Predictor], folder: Path | None
) -> tuple[str, Predictor]:
    """The name and the model of what stands in for the machine: what the folder holds, else the
    best description among the models."""
    if folder is None:
        name, machine = stand_in(models)
        return name, machine.model
    return folder.resolve().name, load_model(plant, folder)


def load_model(plant: Plant, folder: Path) -> Predictor:
    """The predictor in a folder that `trueup fetch` or `trueup diagnose` wrote. Raises
    BadArtifact."""
    inner = folder / "model"
    predictor = load(inner if inner.is_dir() else folder).predictor
    if (predictor.plant.layout, predictor.plant.timestep_s) != (plant.layout, plant.timestep_s):
        raise BadArtifact(
            f"the model in {folder} is of another plant: its channels or its step are not the "
            "case's",
            hint="Name models of this case's plant.",
        )
    return predictor


def remote_study(url: str, plant: str, request: dict[str, Any], what: str) -> dict[str, Any]:
    """Run a study of uploaded versions as a job, and return its report. `versions` and `machine` of
    the request are versions' numbers, or digests or their first digits."""
    client = connect(url)
    named = {
        "versions": [resolve_artifact(client, plant, v) for v in request["versions"]] or None,
        "machine": None
        if request["machine"] is None
        else resolve_artifact(client, plant, request["machine"]),
    }
    return _report(client, plant, {**request, **named}, what)


def remote_consistency(
    url: str, plant: str, version: str | None, *, diagnoses: bool
) -> dict[str, Any]:
    """Run a consistency study of an uploaded version, the newest diagnosis by default, as a job,
    and return its report."""
    client = connect(url)
    request = {
        "kind": "consistency",
        "version": None if version is None else resolve_artifact(client, plant, version),
        "diagnoses": diagnoses,
    }
    return _report(client, plant, request, "consistency")


def remote_report(url: str, plant: str, request: dict[str, Any], what: str) -> dict[str, Any]:
    """Run a job of a plant on the service, and return the report that it leaves behind."""
    return _report(connect(url), plant, request, what)


def _report(client: Client, plant: str, request: dict[str, Any], what: str) -> dict[str, Any]:
    job = run_job(client, plant, request, what)
    report: dict[str, Any] = json.loads(client.output(job["id"], REPORT))
    return report


@dataclass(frozen=True, slots=True)
class Presentation:
    """How the report of one kind of study is told: as a page, in a sentence, on a terminal."""

    page: Callable[[Mapping[str, Any]], str]
    sentence: Callable[[Mapping[str, Any]], str]
    show: Callable[[dict[str, Any]], None]

    def tell(self, document: dict[str, Any], out: Path, *, in_json: bool) -> None:
        """Write the report as JSON and as a page, and print it."""
        out.mkdir(parents=True, exist_ok=True)
        (out / REPORT).write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
        page = out / "report.html"
        page.write_text(self.page(document))
        sentence = self.sentence(document)
        if in_json:
            files = {"report": str(page)}
            as_json({"sentence": sentence, "report": document, "files": files})
            return
        say("[bold]{}[/]", sentence)
        self.show(document)
        say("report: {}", page)


def folder_of(target: str, study: str) -> Path:
    """The folder to write to where none is named."""
    return Path(f"{study}-{Path(target).resolve().name}")
