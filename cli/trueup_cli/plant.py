"""Commands on plants."""

from __future__ import annotations

from pathlib import Path

from cyclopts import App

from trueup.errors import BadPlant
from trueup_cli.exits import CALLS_SERVICE, exit_codes
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect, read_json
from trueup_cli.show import as_json, moment, say, table

app = App(
    name="plant", help="Register and look at plants.", help_epilogue=exit_codes(CALLS_SERVICE)
)


@app.command
def register(file: Path, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Register a plant by its plant.json. An MJCF that it names is read from its folder.

    Parameters
    ----------
    file
        plant.json, or a folder that holds one
    """
    from trueup.model.nominal_form import resolved

    description = file / "plant.json" if file.is_dir() else file
    plant = connect(url).register_plant(
        resolved(read_json(description, BadPlant), description.parent)
    )
    as_json(plant) if as_json_ else say(
        "plant [bold]{}[/] is registered as {}", plant["name"], plant["digest"][:12]
    )


@app.command
def show(name: PlantName, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Show what a plant was declared as; with --json its whole registration."""
    plant = connect(url).plant(name)
    if as_json_:
        as_json(plant)
        return
    declared = plant["document"]
    nominal = declared["nominal"]
    channels = [
        (
            kind,
            c["name"],
            c.get("unit"),
            c.get("joint"),
            " to ".join(f"{x:g}" for x in c.get("limits", ())),
        )
        for kind in ("commands", "observations")
        for c in declared[kind]
    ]
    model = nominal.get("mjcf") or f"{nominal['family']}, " + ", ".join(
        f"{k} = {v:g}" for k, v in nominal["parameters"].items()
    )
    say(
        "[bold]{}[/] {}, registered {} by {}",
        plant["name"],
        plant["digest"][:12],
        moment(plant["created_at"]),
        plant["created_by"],
    )
    say("{}; a step of {:g} ms", model, 1e3 * nominal["timestep_s"])
    table("", ["", "channel", "unit", "joint", "limits"], channels)


@app.command(name="list")
def list_(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List the plants."""
    plants = list(connect(url).plants())
    as_json(plants) if as_json_ else table(
        "Plants",
        ["name", "model", "registered", "by"],
        [
            (
                p["name"],
                p["document"]["nominal"].get("family", "mjcf"),
                p["created_at"],
                p["created_by"],
            )
            for p in plants
        ],
    )
