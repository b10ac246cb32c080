"""`trueup excite`: design the next experiment, a bounded excitation."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import orjson
from cyclopts import Parameter

from trueup.artifact.model import load
from trueup.diagnose.case import read_episodes, read_plant
from trueup.diagnose.excitation_design import SPREAD, Allowed, Design, design
from trueup.diagnose.excitation_files import (
    DESIGN_FILE,
    MEDIA_TYPES,
    excitation_files,
    excitation_report,
)
from trueup.errors import BadArtifact
from trueup.model.corrected import Corrected
from trueup_cli.options import DEFAULT_URL, Json, Seed, Url, connect
from trueup_cli.pictures.excitation import excite_picture
from trueup_cli.registry import run_job
from trueup_cli.show import as_json, progress, say, table
from trueup_cli.study import REPORT, folder_of, is_case
from trueup_pages.excitation import report_page


def excite(
    target: str,
    *,
    out: Path | None = None,
    model: Annotated[
        str | None,
        Parameter(
            help="Folder that `trueup diagnose` wrote: use its model and its uncertainty; of a "
            "plant on the service the id of a diagnosis, default: the newest"
        ),
    ] = None,
    split: Annotated[
        bool,
        Parameter(
            help="Separate the model's effects from the alternatives that the diagnosis left",
            negative="",
        ),
    ] = False,
    spread: Annotated[
        float | None,
        Parameter(
            help="For the declared model: relative 95 % interval of each nominal number; 0.3 "
            "where there is no diagnosis"
        ),
    ] = None,
    duration_s: Annotated[
        float, Parameter(help="Duration of the excitation, without the hold at its end [s]")
    ] = 12.0,
    band_hz: Annotated[
        tuple[float, float] | None,
        Parameter(help="Lowest and highest frequency [Hz]; default: by duration and step"),
    ] = None,
    rate: Annotated[
        float | None,
        Parameter(help="Largest change of a command [its unit / s]; default: as recorded"),
    ] = None,
    speed: Annotated[
        float | None,
        Parameter(help="Largest speed of a joint [its unit / s]; default: as recorded"),
    ] = None,
    margin: Annotated[
        float, Parameter(help="Share of the envelope that is kept free under every model")
    ] = 0.1,
    seed: Seed = 0,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Design a bounded excitation that identifies a plant's numbers, or separates explanations.

    It is safe under every plausible model. It keeps the envelope that plant.json declares, or else
    the range of the recordings. Writes excitation.csv, .mcap (commands alone), .json and a picture:
    excitation.svg, or report.html of a plant on the service. The .csv and the .json begin with what
    to check before it is played.

    Parameters
    ----------
    target
        a case folder with plant.json and any recordings, or the name of a plant on the service
    out
        folder to write to; default: excitation-TARGET
    """
    allowed = Allowed(duration_s, band_hz, rate, speed, margin)
    folder = out or folder_of(target, "excitation")
    folder.mkdir(parents=True, exist_ok=True)
    if is_case(target):
        designed = _run_locally(Path(target), allowed, model, spread, split=split, seed=seed)
        files = {
            **excitation_files(designed),
            "excitation.svg": excite_picture(designed.plant, designed.excitation).encode(),
        }
        report = excitation_report(designed)
    else:
        goal = "split" if split else "identify"
        request = {
            "kind": "excite",
            "goal": goal,
            "diagnosis": model,
            "spread": spread,
            "seed": seed,
            **asdict(allowed),
        }
        report, files = _run_remotely(url, target, request)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    if as_json_:
        as_json(orjson.loads(files[DESIGN_FILE]))
        return
    _show(report)
    names = ", ".join(files)
    say(
        "in {}: {}; declare `excitation = {}` when recorded",
        folder,
        names,
        report["excitation"][:12],
    )


def _run_locally(
    case: Path, allowed: Allowed, model: str | None, spread: float | None, *, split: bool, seed: int
) -> Design:
    plant = read_plant(case)
    episodes = read_episodes(case, plant)
    diagnosed = None if model is None else _diagnosed(Path(model))
    with progress("excite") as bar:
        return design(
            plant,
            episodes,
            allowed,
            diagnosed=diagnosed,
            spread=SPREAD if spread is None else spread,
            split=split,
            seed=seed,
            progress=lambda stage, part: bar(part, stage),
        )


def _run_remotely(
    url: str, plant: str, request: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, bytes]]:
    client = connect(url)
    job = run_job(client, plant, request, "excite")
    left = {name: client.output(job["id"], name) for name in (*MEDIA_TYPES, REPORT)}
    report: dict[str, Any] = orjson.loads(left.pop(REPORT))
    return report, {**left, "report.html": report_page(report).encode()}


def _diagnosed(folder: Path) -> tuple[Corrected, dict[str, Any]]:
    """Returns the corrected model in a diagnosis's folder, and its report. Raises BadArtifact."""
    model = load(folder / "model").predictor
    if not isinstance(model, Corrected):
        raise BadArtifact(
            "the folder holds no corrected model",
            hint="Give the folder that `trueup diagnose --out` wrote.",
        )
    return model, json.loads((folder / "report.json").read_text())


def _show(report: dict[str, Any]) -> None:
    say("[bold]Check before you play it[/]")
    for number, line in enumerate(report["check_first"], 1):
        say("  {}. {}", number, line)
    random, members = report["random"], report["members"]
    table(
        report["title"],
        ["", "designed", "random, same bounds"],
        [
            *(
                (
                    f"{f['what']} [{f['unit']}]" if f["unit"] else f["what"],
                    f["designed"],
                    f["random"],
                )
                for f in report["figures"]
            ),
            (
                "leaves the envelope",
                f"under {report['breaches']} of {members} models",
                f"{random['breaches']} of {random['excitations']}",
            ),
        ],
    )
    unbounded = random["of_same_energy_unbounded"]
    say(
        "random ones of the same energy, which keep no bound but the command's limits: {} of {} "
        "leave the envelope",
        unbounded["breaches"],
        unbounded["excitations"],
    )
    for what in report["not_identified"]:
        say("not identified: {}", what)
    say(
        "{} samples, {:.4g} s; under {} models at most {:.0f} % of the envelope is used, "
        "breaches: {}",
        report["samples"],
        report["duration_s"],
        members,
        100 * report["envelope_used"],
        report["breaches"],
    )
    for how in report["not_parted"]:
        say("Not separated: {}.", how)
