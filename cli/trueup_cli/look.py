"""`trueup look`: open the service in a browser, signed in, at the newest diagnosis."""

from __future__ import annotations

import os
import webbrowser
from contextlib import suppress
from itertools import islice
from typing import Annotated
from urllib.parse import quote, urlencode, urlsplit

from cyclopts import Parameter
from cyclopts.types import ExistingDirectory

from trueup_cli.embedded_service import embedded_service, wait_until_ended
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect, token_for
from trueup_cli.show import as_json, err, say
from trueup_client import Client


def look(
    plant: PlantName | None = None,
    *,
    data: Annotated[
        ExistingDirectory | None,
        Parameter(help="Serve this data folder until Ctrl-C, and open that"),
    ] = None,
    browser: Annotated[bool, Parameter(help="Open a browser; else only print the link")] = True,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Open the service in a browser, signed in, at a plant's newest diagnosis if there is one.

    The link holds a token in its fragment, which no browser sends anywhere. Keep it to yourself.

    Parameters
    ----------
    plant
        name of the plant; the only one, if there is one
    """
    if data is None:
        _open(url, plant, browser=browser, as_json_=as_json_)
        return
    os.environ["TRUEUP_DATA_DIR"] = str(data)  # where `token_for` looks
    with suppress(KeyboardInterrupt), embedded_service(data, urlsplit(url).port) as (_, child):
        _open(url, plant, browser=browser, as_json_=as_json_)
        say("[dim]serving until Ctrl-C[/]", to=err)
        wait_until_ended(child)


def _open(url: str, plant: str | None, *, browser: bool, as_json_: bool) -> None:
    client = connect(url)
    client.whoami()
    page = _best_page(client, plant)
    token = token_for(url)
    link = f"{url}/sign-in?{urlencode({'next': page})}" + (
        f"#token={quote(token, safe='')}" if token else ""
    )
    as_json({"url": link, "page": page}) if as_json_ else say("{}", link)
    if browser:
        webbrowser.open(link)


def _best_page(client: Client, plant: str | None) -> str:
    """Returns the page of the newest diagnosis, else of the plant, else of all plants."""
    if plant is None:
        names = [p["name"] for p in islice(client.plants(), 2)]
        if len(names) != 1:
            return "/"
        plant = str(names[0])
    for job in client.jobs(plant):
        if job["kind"] == "diagnose" and job["state"] == "succeeded":
            return f"/plants/{plant}/diagnoses/{job['id']}"
    return f"/plants/{plant}"
