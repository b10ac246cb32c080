"""`trueup randomise`: draw a family of plants, and fit one predictor for all of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from trueup.artifact.artifact import pack
from trueup.artifact.model import save
from trueup.canonical import digest_of
from trueup.diagnose.case import read_episodes, read_plant
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.errors import BadRandomisation
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.study import Context, randomise
from trueup.randomise.supported import RANDOMISATION_FILE
from trueup.randomise.training import Draws
from trueup_cli.options import (
    DEFAULT_URL,
    ContextSource,
    Json,
    MeasuredParameters,
    Seed,
    Url,
    read_json,
)
from trueup_cli.show import progress, table
from trueup_cli.study import Presentation, folder_of, is_case, remote_report
from trueup_pages.randomisation import report_page, sentence


def randomise_plants(
    target: str,
    *,
    family: Annotated[
        Path | None,
        Parameter(
            help="JSON file of the family; or the folder of a diagnosis, for the ranges that it "
            "supports. Of a plant on the service default: those of its newest diagnosis"
        ),
    ] = None,
    out: Path | None = None,
    plants: Annotated[
        int, Parameter(help="Plants to draw", validator=Number(gte=1, lte=5000))
    ] = 24,
    steps: Annotated[
        int, Parameter(help="Steps to simulate of each plant", validator=Number(gte=2, lte=100_000))
    ] = 160,
    start_scale: Annotated[
        float,
        Parameter(
            help="Standard deviation of the starts, in reporting scales", validator=Number(gte=0.0)
        ),
    ] = 0.4,
    context: ContextSource = "identification",
    measured: MeasuredParameters = None,
    seed: Seed = 0,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Draw plants from a family, simulate them, and fit a blind and a conditioned predictor.

    Says whether the deployment plant lies in the family and among its samples, and what a wrong
    context costs. Writes report.json and report.html. Of a case folder it also writes both models
    and the training episodes; of a plant on the service both models become versions.

    Parameters
    ----------
    target
        a case folder, or the name of a plant on the service
    out
        folder to write to; default: randomised-TARGET
    """
    given = Context(context, measured)
    draws, declared = Draws(plants, steps, start_scale), _declared(family)
    out = out or folder_of(target, "randomised")
    if is_case(target):
        document = _run_locally(Path(target), declared, draws, seed, given, out)
    else:
        request: dict[str, Any] = {
            "kind": "randomise",
            "randomisation": declared,
            "plants": plants,
            "steps": steps,
            "start_scale": start_scale,
            "seed": seed,
            "context": {"by": context, "parameters": measured},
        }
        document = remote_report(url, target, request, "randomise")
    Presentation(report_page, sentence, _show).tell(document, out, in_json=as_json_)


def _declared(family: Path | None) -> Any:
    """The document of a family, None where none is named. Raises BadRandomisation."""
    if family is None:
        return None
    file = family / RANDOMISATION_FILE if family.is_dir() else family
    if not file.is_file():
        raise BadRandomisation(
            f"there is no file {file}",
            field="numbers",
            hint="Name a JSON file, or a folder that `trueup diagnose` wrote.",
        )
    return read_json(file, BadRandomisation)


def _run_locally(
    case: Path, declared: Any, draws: Draws, seed: int, context: Context, out: Path
) -> dict[str, Any]:
    plant = read_plant(case)
    if declared is None:
        raise BadRandomisation(
            "no family is named",
            field="numbers",
            hint="Give --family FILE, or --family FOLDER of a diagnosis.",
        )
    family = Randomisation.of(plant, declared)
    adaptation = [e for e in read_episodes(case, plant) if e.role is Role.ADAPTATION]
    with progress("randomise") as bar:
        randomised, training = randomise(
            family, draws, seed, context, adaptation, lambda stage, share: bar(share, stage)
        )
    for name, model in (("blind", randomised.blind), ("conditioned", randomised.conditioned)):
        artifact = pack(
            model, {"origin": "randomisation", "report": digest_of(dict(randomised.document))}
        )
        save(artifact, out / name)
    _write_training(training, out / "training")
    return dict(randomised.document)


def _write_training(episodes: list[Episode], folder: Path) -> None:
    """Writes training episodes as recordings, to be uploaded or looked at."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, episode in enumerate(episodes):
        with (folder / f"plant-{number:04}.mcap").open("wb") as file:
            write_episode(
                file,
                stamps_ns=np.rint(episode.t_s * 1e9).astype(np.int64),
                observations=episode.observations,
                commands=episode.commands,
                layout=episode.layout,
                role=episode.role,
                conditions=episode.conditions,
            )


def _show(document: dict[str, Any]) -> None:
    boxes = document["membership"]
    table(
        "Parameters",
        ["number", "family box", "sample box", "deployment"],
        [
            (name, _ends(boxes["family_box"], name), _ends(boxes["sample_box"], name), value)
            for name, value in sorted(document["context"]["parameters"].items())
        ],
    )
    if document["errors"]:
        table(
            "Errors on adaptation episodes, in reporting scales",
            ["model", "one step", "rollout"],
            [(e["model"], e["one_step"], e["rollout"]) for e in document["errors"]],
        )
        table(
            "What a wrong context costs the conditioned model",
            ["context", "one step", "rollout", "times its own"],
            [
                (r["context"], r["one_step"], r["rollout"], r["times"])
                for r in document["context_cost"]
            ],
        )


def _ends(box: dict[str, Any] | None, name: str) -> str:
    if box is None or name not in box["numbers"]:
        return ""
    number = box["numbers"][name]
    where = "inside" if number["inside"] else "outside"
    return f"{number['low']:.4g} to {number['high']:.4g}, {where}"
