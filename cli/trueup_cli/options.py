"""Options that many commands share."""

from __future__ import annotations

import errno
import getpass
import json
import os
import re
import socket
from itertools import islice
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote, urlsplit

from cyclopts import Parameter

from trueup.errors import TrueupError
from trueup_cli.show import err, say
from trueup_client import Client, Witness
from trueup_client.problem import ClientError

Url = Annotated[str, Parameter(name="--url", env_var="TRUEUP_URL", help="Address of the service")]
Seed = Annotated[
    int, Parameter(help="Of what is drawn by lot: the same seed gives the same answer")
]
Json = Annotated[bool, Parameter(name="--json", negative=(), help="Print JSON")]
DEFAULT_URL = "http://127.0.0.1:8321"
NAME = re.compile(
    r"[a-z0-9][a-z0-9_-]{0,62}"
)  # what a service may call a plant: nothing else goes into a shell
COMPLETED, COMPLETION_LIMIT_S = 500, 1.0
UNWRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM)
LOOPBACK = ("127.0.0.1", "::1", "localhost")


def read_json(file: Path, kind: type[TrueupError]) -> Any:
    """A file's JSON. Raises an error of that kind where it is none, OSError where there is no
    file."""
    try:
        return json.loads(file.read_text())
    except ValueError as error:
        raise kind(f"{file} is no JSON: {error}") from error


def plants_there(_: object) -> list[str]:
    """Names of plants for a shell to complete; none where the service does not answer at once."""
    url = os.environ.get("TRUEUP_URL", DEFAULT_URL)
    try:
        with Client(url, timeout_s=COMPLETION_LIMIT_S, token=token_for(url)) as client:
            return [
                name
                for plant in islice(client.plants(), COMPLETED)
                if NAME.fullmatch(name := str(plant["name"]))
            ]
    except (ClientError, OSError):
        return []


PlantName = Annotated[str, Parameter(completer=plants_there, help="Name of the plant")]


def seen(url: str) -> tuple[Client, Witness]:
    """The same, once the log was seen to extend what this user saw of it before, and who saw it.
    Raises NotSigned, LogForked."""
    client, pinned = connect(url), os.environ.get("TRUEUP_LOG_KEY")
    witness = Witness(witness_file(url), pinned)
    try:
        client.witness(witness)
    except OSError as error:
        if error.errno not in UNWRITABLE:
            raise
        say(
            "[dim]{} cannot be written: what is seen of the log is not kept[/]",
            witness_file(url),
            to=err,
        )
        witness = Passing(witness_file(url), pinned)
        client.witness(witness)
    return client, witness


class Passing(Witness):
    """A witness that forgets what it saw: where nothing can be written it still holds the log
    against what was seen before."""

    def _keep(self) -> None:
        pass


def witnessed(url: str) -> Client:
    """The client alone."""
    return seen(url)[0]


def witness_file(url: str) -> Path:
    """Where this user keeps what was seen of a service's log."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "trueup" / "seen" / f"{quote(url, safe='')}.json"


def connect(url: str) -> Client:
    """A client whose changes are signed user@host, or TRUEUP_ACTOR."""
    return Client(
        url,
        actor=os.environ.get("TRUEUP_ACTOR") or f"{getpass.getuser()}@{socket.gethostname()}",
        token=token_for(url),
    )


def token_for(url: str) -> str | None:
    """TRUEUP_TOKEN, else what `trueup login` kept for this address, else on this machine the token
    of the first start."""
    given = os.environ.get("TRUEUP_TOKEN")
    if given:
        return given
    kept = login_file(url)
    if kept.exists():
        return kept.read_text().strip()
    first = Path(os.environ.get("TRUEUP_DATA_DIR", ".trueup")) / "admin.token"
    is_here = urlsplit(url).hostname in LOOPBACK and first.is_file() and os.access(first, os.R_OK)
    return first.read_text().strip() if is_here else None


def login_file(url: str) -> Path:
    """Where `trueup login` keeps a token."""
    home = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(home) / "trueup" / "tokens" / quote(url, safe="")
