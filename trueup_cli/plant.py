"""Commands on plants."""

from __future__ import annotations

import json
from pathlib import Path

from cyclopts import App

from trueup_cli.options import DEFAULT_URL, Json, Url, connect
from trueup_cli.show import as_json, out, table

app = App(name="plant", help="Register and look at plants.")


@app.command
def register(file: Path, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Register the plant that a plant.json describes, or a case folder's.

    Parameters
    ----------
    file: plant.json, or a folder that holds one
    """
    found = connect(url).register_plant(json.loads((file / "plant.json" if file.is_dir() else file).read_text()))
    as_json(found) if as_json_ else out.print(f"plant [bold]{found['name']}[/] is registered as {found['digest'][:12]}")


@app.command
def show(name: str, *, url: Url = DEFAULT_URL) -> None:
    """Print a plant's registration as JSON."""
    as_json(connect(url).plant(name))


@app.command(name="list")
def list_(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List the plants."""
    found = list(connect(url).plants())
    as_json(found) if as_json_ else table(
        "Plants",
        ["name", "family", "registered", "by"],
        [(p["name"], p["document"]["nominal"]["family"], p["created_at"], p["created_by"]) for p in found],
    )
