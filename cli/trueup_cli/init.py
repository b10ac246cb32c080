"""`trueup init`: make a case folder from recordings alone."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup.episode.cutting import write_part
from trueup.episode.layout import Layout
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.episode.survey import survey
from trueup.errors import BadPlant, NotAnEpisode
from trueup.fit.first_model import Chosen, choose, describe
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say, table

Force = Annotated[bool, Parameter(negative=(), help="Overwrite a case that is there")]
HELD_OUT = 0.3  # share of the recordings


@Parameter(name="*")
@dataclass(frozen=True)
class CaseOptions:
    """What a person declares about a recording. The rest is identified from it."""

    name: Annotated[str | None, Parameter(help="Name of the plant; default: the log's")] = None
    family: Annotated[
        str | None,
        Parameter(
            help="inertia, pendulum or oscillator; default: the simplest that the data allow"
        ),
    ] = None
    joint: Annotated[str | None, Parameter(help="Name of the joint, if several move")] = None
    observation: Annotated[str | None, Parameter(help="Topic of the observed JointState")] = None
    command: Annotated[str | None, Parameter(help="Topic of the commanded JointState")] = None
    stage: Annotated[
        str, Parameter(help="MIL, SIL, PIL, HIL or physical: where it was recorded")
    ] = "physical"


@dataclass(frozen=True)
class WrittenCase:
    """A case folder that was written: its plant.json, its choices, and its episodes' roles.

    `declared` says whether the recordings declared their roles.
    """

    folder: Path
    document: dict[str, Any]
    chosen: Chosen
    stage: str
    roles: Counter[Role]
    declared: bool


def init(
    log: Path,
    *,
    out: Path,
    options: CaseOptions | None = None,
    force: Force = False,
    as_json_: Json = False,
) -> None:
    """Make a case folder from recordings: an MCAP file, or a bag of `ros2 bag record -s mcap`.

    It finds topics, joint, fields and rates, holds out the last part of the recordings, and
    identifies the numbers of the simplest model that they allow. Its assumptions are printed and
    written to plant.json, where they can be corrected.

    Parameters
    ----------
    log
        MCAP file, or a folder of MCAP files
    out
        case folder to write
    """
    if (out / "plant.json").exists() and not force:
        raise BadPlant(
            f"{out} holds a plant.json already",
            hint="Name another folder with --out, or write over it with --force.",
        )
    written = make_case(log, out, options or CaseOptions())
    if as_json_:
        as_json({"case": str(out), "plant": written.document})
        return
    show_case(written)
    say("next: trueup diagnose {} --out {}", out, out / "diagnosis")


def make_case(log: Path, out: Path, options: CaseOptions) -> WrittenCase:
    """Makes a case folder from recordings. Raises NotAnEpisode, BadPlant, NotIdentifiable."""
    files = sorted(log.glob("*.mcap")) if log.is_dir() else [log]
    if not files:
        raise NotAnEpisode(
            f"{log} holds no *.mcap", rule="samples", hint="Record with `ros2 bag record -s mcap`."
        )
    if out.resolve() in {file.resolve().parent for file in files}:
        raise BadPlant(
            "the case would be written among the recordings", hint="Name another folder with --out."
        )
    out.mkdir(parents=True, exist_ok=True)
    for earlier in out.glob("*.mcap"):  # of a case that was made here before
        earlier.unlink()
    with progress("init") as bar:
        bar(0.0, "looking through the recordings")
        with files[0].open("rb") as stream:
            surveyed = survey(stream, files[0].stat().st_size)
        chosen = choose(
            surveyed, observation=options.observation, command=options.command, joint=options.joint
        )
        bar(0.3, "writing episodes")
        episodes = [
            read_episode(path.read_bytes(), chosen.layout)
            for path in _write_parts(files, chosen, out, options.stage)
        ]
        bar(0.6, "identifying a first model")
        name = options.name or (log.stem if log.is_file() else log.resolve().name)
        plain = re.sub(r"[^a-z0-9_-]+", "-", name.lower()).strip("-_") or "robot"
        document = describe(
            plain[:63], chosen, [e for e in episodes if e.role is Role.ADAPTATION], options.family
        )
    (out / "plant.json").write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return WrittenCase(
        out,
        document,
        chosen,
        options.stage,
        Counter(e.role for e in episodes),
        surveyed.role is not None,
    )


def _write_parts(files: list[Path], chosen: Chosen, out: Path, stage: str) -> list[Path]:
    """Writes the episodes of a case, and returns their files.

    Each recording is one episode, and the last ones are held out; of a single recording the end is
    held out. Roles that recordings declare are kept.
    """
    applied = Layout((), ()).applied_topic
    topics, written = {chosen.observed.topic, chosen.commanded.topic, applied}, list[Path]()
    held_out = max(1, round(HELD_OUT * len(files)))
    for at, file in enumerate(files):
        recorded = file.read_bytes()
        with file.open("rb") as stream:
            surveyed = survey(stream, len(recorded))
        conditions = {"stage": stage, "recording": file.name}
        if surveyed.role is not None:
            parts: list[tuple[Role | None, int | None, int | None]] = [(None, None, None)]
        elif len(files) > 1:
            parts = [
                (Role.VALIDATION if at >= len(files) - held_out else Role.ADAPTATION, None, None)
            ]
        else:
            first, last = chosen.observed.first_ns, chosen.observed.last_ns
            cut = last - int(HELD_OUT * (last - first))
            parts = [(Role.ADAPTATION, None, cut), (Role.VALIDATION, cut, None)]
        for role, begin, end in parts:
            written.append(out / f"{len(written)}-{role or surveyed.role}.mcap")
            with written[-1].open("wb") as to:
                if role is None:
                    to.write(recorded)
                else:
                    write_part(to, recorded, topics, role, conditions, begin, end)
    return written


def show_case(case: WrittenCase) -> None:
    """Prints what was read from the recordings, and what was assumed."""
    document, chosen, stage = case.document, case.chosen, case.stage
    nominal, limits = document["nominal"], document["commands"][0]["limits"]
    numbers = ", ".join(f"{k} = {v:g}" for k, v in nominal["parameters"].items())
    table(
        f"{case.folder / 'plant.json'}",
        ["what", "found", "so"],
        [
            ("plant", document["name"], "its name in a service; --name gives another"),
            (
                "episodes",
                ", ".join(f"{count} {role}" for role, count in case.roles.items()),
                "roles as recorded"
                if case.declared
                else "the last of what was recorded is held out",
            ),
            (
                "observed",
                chosen.observed.topic,
                f"{', '.join(chosen.observed.fields)} of {chosen.joint or 'the first joint'}",
            ),
            (
                "commanded",
                chosen.commanded.topic,
                f"{chosen.command_field}, within {limits[0]:g} and {limits[1]:g} so far",
            ),
            (
                "step",
                f"{1e3 * nominal['timestep_s']:g} ms",
                f"rollouts over {document['evaluation']['horizon_s']:g} s",
            ),
            (
                "first model",
                nominal["family"],
                (
                    f"{numbers}: identified here, without friction or delay; a start, which "
                    "a diagnosis corrects"
                ),
            ),
            ("units", "rad, rad/s, N·m", "assumed; correct them where they are others"),
            (
                "stage",
                stage,
                "assumed: recorded on a machine" if stage == "physical" else "as given",
            ),
        ],
    )
