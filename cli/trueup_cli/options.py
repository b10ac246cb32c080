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
from typing import Annotated, Any, Literal
from urllib.parse import quote, urlsplit

from cyclopts import Parameter

from trueup.errors import TrueupError
from trueup_cli.show import err, say
from trueup_client import Client, Witness
from trueup_client.problem import ClientError

Url = Annotated[str, Parameter(name="--url", env_var="TRUEUP_URL", help="Address of the service")]
Seed = Annotated[
    int, Parameter(help="Seed of the random draws: the same seed gives the same answer")
]
ContextSource = Annotated[
    Literal["identification", "configuration", "measurement"],
    Parameter(help="Where the conditioned predictor's parameters come from"),
]
MeasuredParameters = Annotated[
    dict[str, float] | None,
    Parameter(
        help="A measured parameter of the conditioned predictor: --measured.k 1.25; give it again "
        "for more"
    ),
]
Json = Annotated[bool, Parameter(name="--json", negative=(), help="Print JSON")]
# of a service on this machine, at the port that it, too, reads from the environment
DEFAULT_URL = f"http://127.0.0.1:{os.environ.get('TRUEUP_PORT', '8321')}"
# what a service may call a plant: no other name is passed to a shell
NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,62}")
MOST_COMPLETED, COMPLETION_LIMIT_S = 500, 1.0
UNWRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM)
LOOPBACK = ("127.0.0.1", "::1", "localhost")


def read_json(file: Path, kind: type[TrueupError]) -> Any:
    """Returns a file's JSON. Raises `kind` if it is not JSON, and OSError if there is no file."""
    try:
        return json.loads(file.read_text())
    except ValueError as error:
        raise kind(f"{file} is no JSON: {error}") from error


def complete_plants(_: object) -> list[str]:
    """Returns names of plants for a shell to complete; none if the service does not answer soon."""
    url = os.environ.get("TRUEUP_URL", DEFAULT_URL)
    try:
        with Client(url, timeout_s=COMPLETION_LIMIT_S, token=token_for(url)) as client:
            return [
                name
                for plant in islice(client.plants(), MOST_COMPLETED)
                if NAME.fullmatch(name := str(plant["name"]))
            ]
    except (ClientError, OSError):
        return []


PlantName = Annotated[str, Parameter(completer=complete_plants, help="Name of the plant")]


def connect_with_witness(url: str) -> tuple[Client, Witness]:
    """Returns a client and this user's witness, once the log extends its last checkpoint.

    Raises NotSigned, LogForked.
    """
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
        witness = ReadOnlyWitness(witness_file(url), pinned)
        client.witness(witness)
    return client, witness


class ReadOnlyWitness(Witness):
    """A witness that stores nothing: it checks the log against the last stored checkpoint."""

    def _keep(self) -> None:
        pass


def connect_witnessed(url: str) -> Client:
    """Returns a client, once the log was seen to extend what this user saw of it before."""
    return connect_with_witness(url)[0]


def witness_file(url: str) -> Path:
    """Returns the file of this user's witness of a service's log."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "trueup" / "seen" / f"{quote(url, safe='')}.json"


def connect(url: str) -> Client:
    """Returns a client whose actor is TRUEUP_ACTOR, else user@host."""
    return Client(
        url,
        actor=os.environ.get("TRUEUP_ACTOR") or f"{getpass.getuser()}@{socket.gethostname()}",
        token=token_for(url),
    )


def token_for(url: str) -> str | None:
    """Returns TRUEUP_TOKEN, else the token that `trueup login` stored for this address.

    Else, for a service of this machine, the token of its first admin, if it can be read.
    """
    token = os.environ.get("TRUEUP_TOKEN")
    if token:
        return token
    stored = login_file(url)
    if stored.exists():
        return stored.read_text().strip()
    first = Path(os.environ.get("TRUEUP_DATA_DIR", ".trueup")) / "admin.token"
    is_here = urlsplit(url).hostname in LOOPBACK and first.is_file() and os.access(first, os.R_OK)
    return first.read_text().strip() if is_here else None


def login_file(url: str) -> Path:
    """Returns the file in which `trueup login` stores a token."""
    home = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(home) / "trueup" / "tokens" / quote(url, safe="")
