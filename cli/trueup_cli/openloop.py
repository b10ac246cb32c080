"""`trueup openloop`: how far models' rollouts go astray after some numbers of steps, beside the
bound on it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup.diagnose.case import read_case
from trueup.diagnose.open_loop import HORIZONS, open_loop
from trueup.episode.episode import Episode
from trueup.episode.role import HELD_OUT, Role
from trueup.errors import NotIdentifiable
from trueup_cli.options import DEFAULT_URL, Json, Url
from trueup_cli.show import progress, table
from trueup_cli.study import (
    Models,
    Presentation,
    folder_of,
    is_case,
    local_machine,
    local_models,
    remote_study,
)
from trueup_pages.open_loop import PREMISES, report_page, sentence


def openloop(
    target: str,
    *,
    out: Path | None = None,
    model: Models = (),
    machine: Annotated[
        str | None,
        Parameter(
            help="What stands in for the true step in the bound: a folder, or a version; default: "
            "a diagnosis, else identified parameters, else the nominal plant"
        ),
    ] = None,
    steps: Annotated[
        tuple[int, ...], Parameter(help="Numbers of declared steps; give it again for more")
    ] = HORIZONS,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Roll models out on issued commands alone, and hold their errors against the rollout bound.

    The recordings are those with the role test, else the held-out ones. Says which premises of the
    bound the data break. Writes report.json and report.html.

    Parameters
    ----------
    target
        a case folder, or the name of a plant on the service
    out
        folder to write to; default: openloop-TARGET
    """
    if min(steps) < 1:
        raise NotIdentifiable("a horizon has one step at least", hint="Give --steps 1 or more.")
    if is_case(target):
        document = _run_locally(Path(target), model, machine, steps)
    else:
        request = {
            "kind": "openloop",
            "versions": model,
            "machine": machine,
            "horizons_steps": list(steps),
        }
        document = remote_study(url, target, request, "open loop")
    Presentation(report_page, sentence, _show).tell(
        document, out or folder_of(target, "openloop"), in_json=as_json_
    )


def _run_locally(
    case: Path, named: tuple[str, ...], folder: str | None, steps: tuple[int, ...]
) -> dict[str, Any]:
    plant, episodes = read_case(case)
    models = local_models(plant, episodes, named)
    machine = local_machine(plant, models, None if folder is None else Path(folder))
    with progress("open loop") as bar:
        chosen = _kept_apart(episodes)
        return open_loop(models, machine, chosen, steps, lambda done: bar(done, "rolling out"))


def _kept_apart(episodes: list[Episode]) -> list[Episode]:
    """The episodes of the role test, else those that are held out. Raises NotIdentifiable."""
    for roles in ((Role.TEST,), HELD_OUT):
        chosen = [e for e in episodes if e.role in roles]
        if chosen:
            return chosen
    raise NotIdentifiable(
        "there is no episode of the role test or validation to roll models out on",
        hint="Put one into the case folder that no model was fitted on.",
    )


def _show(document: dict[str, Any]) -> None:
    table(
        "Error in units of the channels' reporting scales",
        ["model", "steps", "mean", "largest", "bound", "windows"],
        [
            (m["model"], e["steps"], e["mean"], e["max"], e["bound"], e["windows"])
            for m in document["models"]
            for e in m["errors"]
        ],
    )
    broken = [
        (PREMISES[p["premise"]], of, p["because"])
        for of, premises in (
            ("the data", document["premises"]),
            *((m["model"], m["premises"]) for m in document["models"]),
        )
        for p in premises
        if p["holds"] is False
    ]
    if broken:
        table("Premises that do not hold", ["premise", "of", "because"], broken)
