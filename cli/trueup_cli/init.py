"""`trueup init`: make a case folder from recordings alone, of any format."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trueup.diagnose.make_case import (
    PLANT_FILE,
    Declared,
    MadeCase,
    find_mapping,
    make_case,
    model_beside,
)
from trueup.errors import BadMapping, BadPlant
from trueup.recording.asked import Asked
from trueup.recording.controllers import read_controllers
from trueup.recording.format import open_runs
from trueup.recording.mapping import read_mapping
from trueup.recording.recording import Clock
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say, table
from trueup_cli.signals import confirmed

Force = Annotated[bool, Parameter(negative=(), help="Overwrite a case that is there")]
PER = "for the position q, the velocity v and the command u"


@Parameter(name="*")
@dataclass(frozen=True)
class CaseOptions:
    """What a person declares about recordings. The rest is found."""

    name: Annotated[str | None, Parameter(help="Name of the plant; default: the log's")] = None
    family: Annotated[
        str | None,
        Parameter(
            help="inertia, pendulum or oscillator; default: the simplest that the data allow"
        ),
    ] = None
    model: Annotated[
        Path | None,
        Parameter(
            name=["--model", "--mjcf", "--urdf"],
            help="MJCF or URDF of the robot; default: the one that lies beside, if any",
        ),
    ] = None
    joint: Annotated[str | None, Parameter(help="Name of the joint, if several move")] = None
    mapping: Annotated[
        Path | None, Parameter(help="File that says which signals are meant, from an earlier case")
    ] = None
    signal: Annotated[
        dict[str, str],
        Parameter(help=f"Name of a signal or column {PER}: --signal.q 'pos [deg]'"),
    ] = field(default_factory=dict)
    unit: Annotated[dict[str, str], Parameter(help=f"Unit of a signal, {PER}: --unit.q deg")] = (
        field(default_factory=dict)
    )
    time: Annotated[str | None, Parameter(help="Column of a table that holds the time")] = None
    time_unit: Annotated[str | None, Parameter(help="Its unit: s, ms, us or ns")] = None
    rate: Annotated[float | None, Parameter(help="Rate of a table that has no time [Hz]")] = None
    names: Annotated[
        str | None,
        Parameter(help="Joints of a list without names, such as Float64MultiArray: j1,j2,j3"),
    ] = None
    controllers: Annotated[
        Path | None,
        Parameter(help="Parameter file of ros2_control, whose controllers list those joints"),
    ] = None
    observation: Annotated[str | None, Parameter(help="Topic of what was observed")] = None
    command: Annotated[str | None, Parameter(help="Topic of the commands")] = None
    stage: Annotated[
        str, Parameter(help="MIL, SIL, PIL, HIL or physical: where it was recorded")
    ] = "physical"
    yes: Annotated[
        bool, Parameter(negative=(), help="Take what is guessed without being asked")
    ] = False

    def declared(self, log: Path) -> Declared:
        """What was declared, with the model that lies beside the log. Raises BadMapping."""
        clock = None
        if self.time is not None or self.time_unit is not None or self.rate is not None:
            clock = Clock(self.time, self.time_unit or "", self.rate)
        if self.mapping is not None and (self.joint or self.signal or self.unit or self.time):
            raise BadMapping(
                "a mapping says all of that: joint, signals, units and time",
                field="mapping",
                hint="Correct the mapping, or leave it out.",
            )
        one_joint = self.family or self.joint or "q" in self.signal or self.mapping
        return Declared(
            self.name or (log.stem if log.is_file() else log.resolve().name),
            self.family,
            self.stage,
            Asked(
                self.signal,
                self.unit,
                self.joint,
                self.observation,
                self.command,
                clock,
                tuple(self.names.split(",")) if self.names else (),
                read_controllers(self.controllers) if self.controllers else {},
            ),
            read_mapping(self.mapping.read_bytes()) if self.mapping else None,
            self.model or (None if one_joint else model_beside(log)),
        )


def init(
    log: Path,
    *,
    out: Path,
    options: CaseOptions | None = None,
    force: Force = False,
    as_json_: Json = False,
) -> None:
    """Make a case folder from recordings: MCAP, ROS bags, CSV, Parquet, HDF5, npz, LeRobot.

    It finds the signals by their names and units, holds out the last part of the recordings, and
    identifies the numbers of the simplest model that they allow, or takes the MJCF or URDF that
    lies beside. What it guesses is shown and asked for once; it is written to mapping.json, which
    --mapping uses again.

    Parameters
    ----------
    log
        file or folder of recordings
    out
        case folder to write
    """
    if (out / PLANT_FILE).exists() and not force:
        raise BadPlant(
            f"{out} holds a plant.json already",
            hint="Name another folder with --out, or write over it with --force.",
        )
    made = case_of(log, out, options or CaseOptions(), is_quiet=as_json_)
    if as_json_:
        as_json(
            {
                "case": str(out),
                "plant": made.document,
                "mapping": made.mapping.document(),
                "findings": [f.document() for f in made.findings],
            }
        )
        return
    show_case(made)
    say("next: trueup diagnose {} --out {}", out, out / "diagnosis")


def case_of(log: Path, out: Path, options: CaseOptions, *, is_quiet: bool) -> MadeCase:
    """Makes a case folder from recordings. Raises BadEpisode, BadMapping, BadPlant,
    NotIdentifiable."""
    runs = open_runs(log)
    if out.resolve() in {run.path.resolve().parent for run in runs}:
        raise BadPlant(
            "the case would be written among the recordings", hint="Name another folder with --out."
        )
    declared = options.declared(log)
    with progress("init") as bar:
        bar(0.0, "looking through the recordings")
        mapping = find_mapping(runs, declared)
    if not is_quiet:
        mapping = confirmed(mapping, is_agreed=options.yes)
    with progress("init") as bar:
        return make_case(runs, out, mapping, declared, lambda stage, part: bar(part, stage))


def show_case(case: MadeCase) -> None:
    """Prints what was read from the recordings, and what was assumed."""
    document, stage = case.document, case.stage
    nominal = document["nominal"]
    numbers = ", ".join(f"{k} = {v:g}" for k, v in nominal.get("parameters", {}).items())
    reach = ", ".join(
        f"{c['name']} within {c['limits'][0]:g} and {c['limits'][1]:g}"
        for c in document["commands"]
    )
    units = ", ".join(
        f"{c['name']} [{c['unit'] or '?'}]"
        for c in (*document["observations"], *document["commands"])
    )
    table(
        f"{case.folder / PLANT_FILE}",
        ["what", "found", "so"],
        [
            ("plant", document["name"], "its name in a service; --name gives another"),
            (
                "episodes",
                ", ".join(f"{count} {role}" for role, count in case.roles.items()),
                "roles as recorded"
                if case.is_role_declared
                else "the last of what was recorded is held out",
            ),
            ("commands", reach, "as far as the recordings reach"),
            (
                "step",
                f"{1e3 * nominal['timestep_s']:g} ms",
                f"rollouts over {document['evaluation']['horizon_s']:g} s",
            ),
            (
                "first model",
                nominal.get("family") or nominal["mjcf"],
                (
                    f"{numbers}: identified here, without friction or delay; a start, which "
                    "a diagnosis corrects"
                )
                if numbers
                else "as it lies beside the recordings",
            ),
            ("units", units, "after conversion; correct them in plant.json if they are others"),
            (
                "stage",
                stage,
                "assumed: recorded on a machine" if stage == "physical" else "as given",
            ),
        ],
    )
    if nominal.get("parameters", {}).get("b", 0.0) < 0.0:
        say(
            "[yellow]negative gain[/]: the joint goes against its command in these recordings. "
            "Check the sign of the command, and that it is this joint's."
        )
    for finding in case.findings:
        say("[yellow]{}[/]: {}. {}", finding.fault, finding.evidence, finding.advice)
