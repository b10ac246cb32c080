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
    """Register the plant that a plant.json describes, or a case folder's; an MJCF that it names is read from beside it.

    Parameters
    ----------
    file: plant.json, or a folder that holds one
    """
    from trueup.model.mjcf import resolved

    description = file / "plant.json" if file.is_dir() else file
    found = connect(url).register_plant(resolved(json.loads(description.read_text()), description.parent))
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
        ["name", "model", "registered", "by"],
        [(p["name"], p["document"]["nominal"].get("family", "mjcf"), p["created_at"], p["created_by"]) for p in found],
    )
