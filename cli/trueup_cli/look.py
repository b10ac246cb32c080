"""`trueup look`: open the service in a browser, signed in, where there is most to see."""

from __future__ import annotations

import os
import webbrowser
from contextlib import suppress
from typing import Annotated
from urllib.parse import quote, urlencode, urlsplit

from cyclopts import Parameter
from cyclopts.types import ExistingDirectory

from trueup_cli.beside import service_beside, wait
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect, token_for
from trueup_cli.show import as_json, err, say
from trueup_client import Client


def look(
    plant: PlantName | None = None,
    *,
    data: Annotated[
        ExistingDirectory | None,
        Parameter(help="Serve this data folder until Ctrl-C, and look at that"),
    ] = None,
    browser: Annotated[
        bool, Parameter(help="Open a browser; else the link is printed alone")
    ] = True,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Open the service in a browser, signed in: at a plant's newest diagnosis, where there is one.

    The link holds a token in its fragment, which no browser sends anywhere; keep it to yourself.

    Parameters
    ----------
    plant
        name of the plant; the only one, if there is one
    """
    if data is None:
        _open(url, plant, browser=browser, as_json_=as_json_)
        return
    os.environ["TRUEUP_DATA_DIR"] = str(data)  # whose token is asked for
    with suppress(KeyboardInterrupt), service_beside(data, urlsplit(url).port) as (_, child):
        _open(url, plant, browser=browser, as_json_=as_json_)
        say("[dim]serving until Ctrl-C[/]", to=err)
        wait(child)


def _open(url: str, plant: str | None, *, browser: bool, as_json_: bool) -> None:
    client = connect(url)
    client.whoami()
    to = _best_page(client, plant)
    token = token_for(url)
    link = f"{url}/sign-in?{urlencode({'next': to})}" + (
        f"#token={quote(token, safe='')}" if token else ""
    )
    as_json({"url": link, "page": to}) if as_json_ else say("{}", link)
    if browser:
        webbrowser.open(link)


def _best_page(client: Client, plant: str | None) -> str:
    """The newest diagnosis that found something, else the plant, else all plants."""
    if plant is None:
        first = [p["name"] for _, p in zip(range(2), client.plants(), strict=False)]
        if len(first) != 1:
            return "/"
        plant = str(first[0])
    for job in client.jobs(plant):
        if job["kind"] == "diagnose" and job["state"] == "succeeded":
            return f"/plants/{plant}/diagnoses/{job['id']}"
    return f"/plants/{plant}"
