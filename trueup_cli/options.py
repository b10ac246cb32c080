"""Options that many commands share."""

from __future__ import annotations

import getpass
import os
import socket
from typing import Annotated

from cyclopts import Parameter

from trueup_client import Client

Url = Annotated[str, Parameter(name="--url", env_var="TRUEUP_URL", help="Address of the service")]
Json = Annotated[bool, Parameter(name="--json", negative=(), help="Print JSON")]
DEFAULT_URL = "http://127.0.0.1:8321"


def connect(url: str) -> Client:
    """A client whose changes are signed user@host, or TRUEUP_ACTOR."""
    return Client(url, actor=os.environ.get("TRUEUP_ACTOR") or f"{getpass.getuser()}@{socket.gethostname()}")
