"""`trueup look`: open the service in a browser, signed in, where there is most to see."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated
from urllib.parse import quote, urlencode

from cyclopts import Parameter
from cyclopts.types import ExistingDirectory

from trueup_cli.options import DEFAULT_URL, Url, connect, token_for
from trueup_cli.show import err, progress
from trueup_client import Client, Unreachable

START_LIMIT_S, PAUSE_S = 60.0, 0.1


def look(
    plant: str | None = None,
    *,
    data: Annotated[ExistingDirectory | None, Parameter(help="Serve this data folder until Ctrl-C, and look at that")] = None,
    browser: Annotated[bool, Parameter(help="Open a browser; else the link is printed alone")] = True,
    url: Url = DEFAULT_URL,
) -> None:
    """Open the service in a browser, signed in: at a plant's newest diagnosis, where there is one.

    The link holds a token in its fragment, which no browser sends anywhere; keep it to yourself.

    Parameters
    ----------
    plant: name of the plant; the only one, if there is one
    """
    if data is None:
        _open(url, plant, browser=browser)
        return
    with _serving(data, url) as child:
        _open(url, plant, browser=browser)
        err.print("[dim]serving until Ctrl-C[/]")
        child.wait()


def _open(url: str, plant: str | None, *, browser: bool) -> None:
    client = connect(url)
    client.whoami()
    to = _best_page(client, plant)
    token = token_for(url)
    link = f"{url}/sign-in?{urlencode({'next': to})}" + (f"#token={quote(token, safe='')}" if token else "")
    print(link, flush=True)
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


@contextmanager
def _serving(data: Path, url: str) -> Iterator[subprocess.Popen[bytes]]:
    """A server with a worker on a data folder, at the port of this address, until the end."""
    os.environ["TRUEUP_DATA_DIR"] = str(data)
    port = url.rpartition(":")[2].strip("/")
    child = subprocess.Popen([sys.executable, "-m", "trueup_cli.main", "serve", "--port", port], stderr=subprocess.DEVNULL)
    try:
        with progress("starting"):
            _wait_until_ready(url, child)
        yield child
    except KeyboardInterrupt:
        pass
    finally:
        child.terminate()
        child.wait()


def _wait_until_ready(url: str, child: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline and child.poll() is None:
        try:
            if Client(url).is_ready():
                return
        except Unreachable:
            pass
        time.sleep(PAUSE_S)
    raise Unreachable(f"the service did not start at {url}; another one may be there: give --url with another port")
