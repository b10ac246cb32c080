"""`trueup init`: a case folder from recordings alone."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup.episode.cutting import write_part
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.episode.survey import survey
from trueup.errors import BadPlant, NotAnEpisode
from trueup.fit.first_model import Chosen, choose, describe
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say, table

Force = Annotated[bool, Parameter(negative=(), help="Write over a case that is there")]
HELD_OUT = 0.3  # of what was recorded


@Parameter(name="*")
@dataclass(frozen=True)
class Wanted:
    """What a person says of a recording; the rest is found."""

    name: Annotated[str | None, Parameter(help="Of the plant; default: the log's")] = None
    family: Annotated[
        str | None,
        Parameter(
            help="inertia, pendulum or oscillator; default: the simplest that the data allow"
        ),
    ] = None
    joint: Annotated[str | None, Parameter(help="Which one, where several move")] = None
    observation: Annotated[str | None, Parameter(help="Topic of the observed JointState")] = None
    command: Annotated[str | None, Parameter(help="Topic of the commanded JointState")] = None
    stage: Annotated[
        str, Parameter(help="MIL, SIL, PIL, HIL or physical: where it was recorded")
    ] = "physical"


@dataclass(frozen=True)
class Made:
    """A case folder that was written: its plant.json, its episodes' roles, and what was found and
    assumed for it."""

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
    wanted: Wanted | None = None,
    force: Force = False,
    as_json_: Json = False,
) -> None:
    """Make a case folder from recordings: an MCAP file, or what `ros2 bag record -s mcap` left
    behind.

    Finds topics, joint, fields and rates, holds the last part of the recordings out, and identifies
    the numbers of the simplest model that they allow. What it assumed is printed, and stands in
    plant.json to be corrected.

    Parameters
    ----------
    log
        MCAP file, or a folder of some
    out
        case folder to write
    """
    if (out / "plant.json").exists() and not force:
        raise BadPlant(
            f"{out} holds a plant.json already",
            hint="Name another folder with --out, or write over it with --force.",
        )
    made = make_case(log, out, wanted or Wanted())
    if as_json_:
        as_json({"case": str(out), "plant": made.document})
        return
    tell(made)
    say("next: trueup diagnose {} --out {}", out, out / "diagnosis")


def make_case(log: Path, out: Path, wanted: Wanted) -> Made:
    """The same, for a command that goes on. Raises NotAnEpisode, BadPlant, NotIdentifiable."""
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
    for left in out.glob("*.mcap"):  # of a case that was made here before
        left.unlink()
    with progress("init") as bar:
        bar(0.0, "looking through the recordings")
        with files[0].open("rb") as stream:
            found = survey(stream, files[0].stat().st_size)
        chosen = choose(
            found, observation=wanted.observation, command=wanted.command, joint=wanted.joint
        )
        bar(0.3, "writing episodes")
        episodes = [
            read_episode(path.read_bytes(), chosen.layout)
            for path in _write_parts(files, chosen, out, wanted.stage)
        ]
        bar(0.6, "identifying a first model")
        named = wanted.name or (log.stem if log.is_file() else log.resolve().name)
        plain = re.sub(r"[^a-z0-9_-]+", "-", named.lower()).strip("-_") or "robot"
        document = describe(
            plain[:63], chosen, [e for e in episodes if e.role is Role.ADAPTATION], wanted.family
        )
    (out / "plant.json").write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return Made(
        out,
        document,
        chosen,
        wanted.stage,
        Counter(e.role for e in episodes),
        found.role is not None,
    )


def _write_parts(files: list[Path], chosen: Chosen, out: Path, stage: str) -> list[Path]:
    """Episodes of the case: each file is one, the last ones held out; the end of a single one.
    Roles that files declare are kept."""
    topics, written = {chosen.observed.topic, chosen.commanded.topic}, list[Path]()
    held_out = max(1, round(HELD_OUT * len(files)))
    for at, file in enumerate(files):
        recorded = file.read_bytes()
        with file.open("rb") as stream:
            found = survey(stream, len(recorded))
        conditions = {"stage": stage, "recording": file.name}
        if found.role is not None:
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
            written.append(out / f"{len(written)}-{role or found.role}.mcap")
            with written[-1].open("wb") as to:
                if role is None:
                    to.write(recorded)
                else:
                    write_part(to, recorded, topics, role, conditions, begin, end)
    return written


def tell(made: Made) -> None:
    """Print what was found, and what was assumed."""
    document, chosen, out, stage = made.document, made.chosen, made.folder, made.stage
    nominal, limits = document["nominal"], document["commands"][0]["limits"]
    numbers = ", ".join(f"{k} = {v:g}" for k, v in nominal["parameters"].items())
    table(
        f"{out / 'plant.json'}",
        ["what", "found", "so"],
        [
            ("plant", document["name"], "its name in a service; --name gives another"),
            (
                "episodes",
                ", ".join(f"{count} {role}" for role, count in made.roles.items()),
                "roles as recorded"
                if made.declared
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
