"""`trueup closedloop`: how models track with a fixed planner, when the machine is not what they
believe."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from trueup.control.courses import Courses, Travelled
from trueup.control.machine import machine_of
from trueup.control.regimes import REGIMES, Conditions, run_regimes
from trueup.diagnose.case import read_episodes, read_plant
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.model.plant import Plant
from trueup_cli.options import DEFAULT_URL, Json, Url
from trueup_cli.show import progress, say, table
from trueup_cli.study import (
    Models,
    Presentation,
    folder_of,
    is_case,
    local_machine,
    local_models,
    remote_study,
)
from trueup_pages.closed_loop import NAMES, report_page, sentence

Name = Literal["nominal", "shifted", "delayed", "reduced_authority"]


def closedloop(
    target: str,
    *,
    out: Path | None = None,
    model: Models = (),
    machine: Annotated[
        str | None,
        Parameter(
            help="What stands in for the machine: a folder, or a version; default: a "
            "diagnosis, else identified parameters, else the nominal plant"
        ),
    ] = None,
    regime: Annotated[
        tuple[Name, ...], Parameter(help="Regimes to run; give it again for more; default: all")
    ] = (),
    seed: Annotated[
        tuple[int, ...],
        Parameter(help="Seeds of the planner, one run of each reference each; default: 0 to 3"),
    ] = (0, 1, 2, 3),
    delay_ticks: Annotated[
        int,
        Parameter(help="Sensor delay, delayed regime [ticks]", validator=Number(gte=0, lte=1000)),
    ] = 3,
    authority: Annotated[
        float,
        Parameter(
            help="Share of each command's range in the reduced regime",
            validator=Number(gt=0.0, lte=1.0),
        ),
    ] = 0.5,
    sweep_ticks: Annotated[
        tuple[int, ...], Parameter(help="Sensor delays to sweep; give it again for more")
    ] = (),
    amplitude: Annotated[
        float | None,
        Parameter(
            help="Amplitude of one sine to follow, in the joint's unit; needs --frequency-hz",
            validator=Number(gt=0.0),
        ),
    ] = None,
    frequency_hz: Annotated[
        float | None, Parameter(help="Frequency of that sine [Hz]", validator=Number(gt=0.0))
    ] = None,
    ticks: Annotated[
        int,
        Parameter(help="Ticks of the controller in each run", validator=Number(gte=10, lte=5000)),
    ] = 200,
    effort: Annotated[
        float | None,
        Parameter(
            help="Weight of the squared command, in squared position units of one joint",
            validator=Number(gte=0.0),
        ),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Run models in closed loop with a fixed planner; report tracking error and breaches.

    A better prediction need not track better. Every model gets the same references, seeds and
    draws in four regimes: the nominal plant, a stand-in for the machine, the stand-in observed
    late, and the stand-in with reduced command range. Writes report.json and report.html. All of
    it is simulation (MIL).

    Parameters
    ----------
    target
        a case folder, or the name of a plant on the service
    out
        folder to write to; default: closedloop-TARGET
    """
    if (amplitude is None) != (frequency_hz is None):
        raise NotIdentifiable(
            "a reference needs its amplitude and its frequency",
            hint="Give --amplitude and --frequency-hz, or neither.",
        )
    conditions = Conditions(regime or REGIMES, seed, delay_ticks, authority, sweep_ticks)
    reference = (amplitude, frequency_hz) if amplitude and frequency_hz else None
    if is_case(target):
        document = _run_locally(Path(target), model, machine, conditions, reference, ticks, effort)
    else:
        document = remote_study(
            url,
            target,
            {
                "kind": "closedloop",
                "versions": model,
                "machine": machine,
                **conditions.document(),
                "reference": reference
                and {"amplitude": reference[0], "frequency_hz": reference[1]},
                "ticks": ticks,
                "effort": effort,
            },
            "closed loop",
        )
    Presentation(report_page, sentence, _show).tell(
        document, out or folder_of(target, "closedloop"), in_json=as_json_
    )


def _run_locally(
    case: Path,
    named: tuple[str, ...],
    folder: str | None,
    conditions: Conditions,
    reference: tuple[float, float] | None,
    ticks: int,
    effort: float | None,
) -> dict[str, Any]:
    plant = read_plant(case)
    episodes = read_episodes(case, plant)
    models = local_models(plant, episodes, named)
    name, stands_in = local_machine(plant, models, None if folder is None else Path(folder))
    courses = _courses(plant, episodes, reference, ticks, effort)
    with progress("closed loop") as bar:
        return run_regimes(
            (name, machine_of(stands_in)),
            models,
            courses,
            conditions,
            lambda done: bar(done, "running"),
        )


def _courses(
    plant: Plant,
    episodes: list[Episode],
    reference: tuple[float, float] | None,
    ticks: int,
    effort: float | None,
) -> Courses:
    """The declared reference, or waves as far as adaptation episodes travelled."""
    if reference is not None:
        return Courses.declared(plant, *reference, ticks, effort)
    adaptation = [e for e in episodes if e.role is Role.ADAPTATION]
    if not adaptation:
        raise NotIdentifiable(
            "there is no adaptation episode to take the travel from",
            hint="Put one into the case folder, or give --amplitude and --frequency-hz.",
        )
    return Courses.within(plant, Travelled.of(plant, adaptation), ticks, effort)


def _show(document: dict[str, Any]) -> None:
    machine = document["machine"]
    why = f", because {machine['why']}" if machine["why"] else ""
    say("{} stands in for the machine: {}{}", machine["model"], machine["stands_in"], why)
    for left in document["left_out"]:
        say("[yellow]left out: {}: {}[/]", NAMES[left["regime"]], left["why"])
    table(
        f"Mean squared tracking error [{document['unit']}]",
        ["regime", "model", "error", "change", "outside the envelope"],
        [
            (
                NAMES[r["regime"]],
                m["model"],
                m["tracking"],
                m["change"],
                None if m["breaches"] is None else m["breaches"]["share"],
            )
            for r in document["regimes"]
            for m in r["models"]
        ],
    )
    if document["sweep"]:
        table(
            "By delay of the sensor",
            ["ticks", "model", "error", "brought forward"],
            [
                (s["delay_ticks"], s["model"], s["tracking"], s["stamped"])
                for s in document["sweep"]
            ],
        )
