"""`trueup excite`: design the next experiment, a bounded excitation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from trueup.artifact.model import load
from trueup.canonical import digest_of
from trueup.collect.checklist import command_table
from trueup.collect.excitation import RANDOM, Excitation
from trueup.diagnose.case import read_episodes, read_plant
from trueup.diagnose.excitation_design import Allowed, design
from trueup.episode.writer import write_episode
from trueup.errors import BadArtifact
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup_cli.options import Json, Seed
from trueup_cli.pictures.excitation import excite_picture
from trueup_cli.show import as_json, progress, say, table


def excite(
    plant: Path,
    *,
    out: Path,
    model: Annotated[
        Path | None,
        Parameter(help="Folder that `trueup diagnose` wrote: use its model and its uncertainty"),
    ] = None,
    split: Annotated[
        bool,
        Parameter(
            help="Separate the model's effects from the alternatives that the diagnosis left",
            negative="",
        ),
    ] = False,
    spread: Annotated[
        float, Parameter(help="Without a model: relative 95 % interval of each nominal number")
    ] = 0.3,
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
    as_json_: Json = False,
) -> None:
    """Design a bounded excitation that identifies a plant's numbers, or separates explanations.

    It is safe under every plausible model. It keeps the envelope that plant.json declares, or else
    the range of the recordings in the case folder. Writes excitation.csv, .mcap (commands alone),
    .json and .svg. The .csv and the .json begin with what to check before it is played.

    Parameters
    ----------
    plant
        case folder with plant.json, and any recordings
    out
        folder to write to
    """
    described = read_plant(plant)
    episodes = read_episodes(plant, described)
    diagnosed = None if model is None else _diagnosed(model)
    allowed = Allowed(duration_s, band_hz, rate, speed, margin)
    with progress("excite") as bar:
        designed = design(
            described,
            episodes,
            allowed,
            diagnosed=diagnosed,
            spread=spread,
            split=split,
            seed=seed,
            progress=lambda stage, part: bar(part, stage),
        )
    document, excitation = dict(designed.document), designed.excitation
    _write(described, excitation, document, out)
    if as_json_:
        as_json(document)
        return
    _show(excitation, designed.check_first)
    for how in designed.not_parted:
        say("Not parted: {}.", how)
    files, digest = "excitation.csv, excitation.mcap, excitation.svg", digest_of(document)
    say("in {}: {}; declare `excitation = {}` when recorded", out, files, digest[:12])


def _diagnosed(folder: Path) -> tuple[Corrected, dict[str, Any]]:
    """Returns the corrected model in a diagnosis's folder, and its report. Raises BadArtifact."""
    model = load(folder / "model").predictor
    if not isinstance(model, Corrected):
        raise BadArtifact(
            "the folder holds no corrected model",
            hint="Give the folder that `trueup diagnose --out` wrote.",
        )
    return model, json.loads((folder / "report.json").read_text())


def _write(plant: Plant, excitation: Excitation, document: dict[str, Any], out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    (out / "excitation.csv").write_text(
        command_table(plant, excitation.t_s, excitation.command, document["check_first"]),
        newline="",
    )
    with (out / "excitation.mcap").open("wb") as mcap:
        write_episode(
            mcap,
            stamps_ns=np.rint(excitation.t_s * 1e9).astype(np.int64),
            observations=np.zeros((0, len(plant.layout.observations))),
            commands=excitation.command[:, [plant.joint_of(c) for c in plant.layout.commands]],
            layout=plant.layout,
            role=None,
            conditions={"plant": plant.name, "excitation": digest_of(document)},
        )
    (out / "excitation.json").write_text(json.dumps(document, indent=1) + "\n")
    (out / "excitation.svg").write_text(excite_picture(plant, excitation))


def _show(excitation: Excitation, first: list[str]) -> None:
    say("[bold]Check before you play it[/]")
    for number, line in enumerate(first, 1):
        say("  {}. {}", number, line)
    random = excitation.random
    others = dict(random.information.rows())
    table(
        excitation.title,
        ["", "designed", "random, same bounds"],
        [
            *((name, value, others[name]) for name, value in excitation.information.rows()),
            (
                "leaves the envelope",
                f"under {excitation.breaches} of {len(excitation.paths)} models",
                f"{random.breaches} of {random.count}",
            ),
        ],
    )
    say(
        "random ones of the same energy, which keep no bound but the command's limits: {} of {} "
        "leave the envelope",
        random.unbounded_breaches,
        RANDOM,
    )
    for what in excitation.not_identified:
        say("not identified: {}", what)
    length, models, share = (
        f"{len(excitation.t_s)} samples, {excitation.t_s[-1]:.4g} s",
        len(excitation.paths),
        100 * excitation.used,
    )
    say(
        "{}; under {} models at most {:.0f} % of the envelope is used, breaches: {}",
        length,
        models,
        share,
        excitation.breaches,
    )
