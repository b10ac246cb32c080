"""`trueup excite`: design the next experiment, a bounded excitation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from numpy.typing import NDArray

from trueup.artifact.model import load
from trueup.canonical import digest_of
from trueup.collect.bounds import Bounds, Recorded
from trueup.collect.checklist import checks, command_table
from trueup.collect.ensemble import Ensemble, InPlay
from trueup.collect.excitation import (
    DETECTABLE,
    RANDOM,
    Excitation,
    Setting,
    identification,
    resting,
    splitting,
)
from trueup.collect.goal import Separation
from trueup.diagnose.case import read_episodes, read_plant
from trueup.diagnose.data_quality import assess
from trueup.diagnose.indistinguishable import how_to_part
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.errors import BadArtifact, NotIdentifiable
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states
from trueup_cli.options import Json, Seed
from trueup_cli.pictures.excitation import excite_picture
from trueup_cli.show import as_json, progress, say, table

Array = NDArray[np.float64]
ELSEWHERE = "add another sensor at the joint, or another load"
QUIET = 1e-3  # share of the reporting scale: the noise assumed without a recording


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
    described.require_known_envelope()
    episodes = [e for e in read_episodes(plant, described) if e.role is Role.ADAPTATION]
    play, report = _in_play(described, model, spread)
    if split and len(play.ensembles) == 1:
        raise _nothing_to_split(report)
    recorded = Recorded.of(described, episodes)
    bounds = Bounds.of(described, duration_s, band_hz, rate, margin, speed=speed, recorded=recorded)
    with progress("excite") as bar:
        hold, rest = resting(play.ensembles[0], bounds, _candidates(described, episodes, bounds))
        setting = Setting(play, bounds, _noise(described, episodes, report), rest, hold)
        act = splitting if split else identification
        excitation = act(setting, np.random.default_rng(seed), lambda stage, part: bar(part, stage))
    information = excitation.information
    if isinstance(information, Separation) and max(information.standard_errors) < DETECTABLE:
        raise NotIdentifiable(
            "no command that was tried within the bounds parts the alternatives by "
            f"{DETECTABLE:g} standard errors, at best "
            f"{max(information.standard_errors):.1f}",
            hint="; or ".join(_otherwise(play, information))
            + "; or allow a longer duration, a wider band or envelope.",
        )
    goal = "split" if split else "identify"
    first = checks(described, excitation, diagnosed=model is not None)
    document = {
        "check_first": first,
        "schema": "trueup.excitation/1",
        "plant": described.name,
        "goal": goal,
        "seed": seed,
        **excitation.document(),
    }
    _write(described, excitation, document, out)
    if as_json_:
        as_json(document)
        return
    _show(excitation, first)
    if isinstance(information, Separation):
        for how in _otherwise(play, information):
            say("Not parted: {}.", how)
    files, digest = "excitation.csv, excitation.mcap, excitation.svg", digest_of(document)
    say("in {}: {}; declare `excitation = {}` when recorded", out, files, digest[:12])


def _in_play(plant: Plant, folder: Path | None, spread: float) -> tuple[InPlay, dict[str, Any]]:
    """Returns the models that may be right, a diagnosis's answer first, and its report."""
    if folder is None:
        return InPlay((Ensemble.prior(plant, spread),)), {}
    model = load(folder / "model").predictor
    if not isinstance(model, Corrected):
        raise BadArtifact(
            "the folder holds no corrected model",
            hint="Give the folder that `trueup diagnose --out` wrote.",
        )
    report = json.loads((folder / "report.json").read_text())
    return InPlay(
        (Ensemble.posterior(model, report), *Ensemble.alternatives(model.plant, report))
    ), report


def _otherwise(play: InPlay, separation: Separation) -> list[str]:
    """Returns what would separate each alternative that the experiment does not."""
    answer, *others = (e.hypothesis for e in play.ensembles)
    apart = zip(others, separation.alternatives, separation.standard_errors, strict=True)
    short = [(other, " + ".join(names)) for other, names, x in apart if x < DETECTABLE]
    return [f"for {names}, {how_to_part(answer, other) or ELSEWHERE}" for other, names in short]


def _nothing_to_split(report: dict[str, Any]) -> NotIdentifiable:
    if not report:
        return NotIdentifiable(
            "there are no alternatives to split without a diagnosis",
            hint="Give its folder with --model.",
        )
    why = (report.get("next_experiment") or {}).get("why")
    if report["indistinguishable"] and "alternatives" not in report["evidence"]:
        why = "Its report does not keep the alternatives as they were fitted: diagnose again."
    return NotIdentifiable(
        "the diagnosis left no alternatives that a command could split",
        hint=why or "Its answer is unique: leave out --split to sharpen its numbers.",
    )


def _candidates(plant: Plant, episodes: list[Episode], bounds: Bounds) -> list[tuple[Array, Array]]:
    """Returns pairs of a command to hold and a state from which to seek rest.

    For one joint it is no command in the middle of the envelope. Each recording adds its first and
    its mean command and state. A robot's rest is unknown without a recording, because its commands
    hold it against its weight. Raises NotIdentifiable if there is no pair.
    """
    joints = len(plant.joints)
    middle = np.concatenate([bounds.envelope[:joints].mean(axis=1), np.zeros(joints)])
    none = np.clip(np.zeros(joints), bounds.low, bounds.high)
    pairs = [(none, middle)] if joints == 1 else []
    for episode in episodes[:1]:
        states = np.nan_to_num(smoothed_states(plant, episode))
        commands = plant.applied(episode.commands)
        states[:, joints:] = 0.0
        pairs += [(commands[0], states[0]), (commands.mean(axis=0), states.mean(axis=0))]
    if not pairs:
        raise NotIdentifiable(
            "a robot's rest is not known without a recording",
            hint="Put an adaptation episode that begins at rest into the case folder.",
        )
    return pairs


def _noise(plant: Plant, episodes: list[Episode], report: dict[str, Any]) -> Array:
    """Returns the noise of each observation `(observations,)`.

    It is the diagnosis's estimate, enlarged by its misfit; else as recorded, or QUIET.
    """
    quiet = QUIET * plant.scales
    if report:
        noise = np.array(
            [report["evidence"]["noise"][c.name] for c in plant.layout.observations], float
        )
        misfit = np.sqrt(max(report["evidence"].get("misfit") or 1.0, 1.0))
        return np.asarray(misfit * np.where(np.isfinite(noise) & (noise > 0.0), noise, quiet))
    if not episodes:
        return quiet
    measured = assess(plant, episodes).noise[plant.state_columns]
    return np.where(np.isfinite(measured) & (measured > 0.0), measured, quiet)


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
