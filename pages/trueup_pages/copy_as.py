"""Copy as: the command and the REST call that do what a form of a page does."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from typing import Any

DOCUMENTS = ("/gates", "/policies")  # routes that take a file of JSON
AUTHORISED = '-H "Authorization: Bearer $TRUEUP_TOKEN"'


def command(*words: object) -> str:
    """Returns a line of a shell that runs `trueup` with these words."""
    return shlex.join(["trueup", *map(str, words)])


def rest(method: str, path: str, body: Mapping[str, Any] | None = None) -> str:
    """Returns a line of a shell that sends a request to the service by curl, with TRUEUP_URL and
    TRUEUP_TOKEN of the environment."""
    line = f'curl -X {method} {AUTHORISED} "$TRUEUP_URL{path}"'
    if body is None:
        return line
    return f"{line} --json {shlex.quote(json.dumps(body, ensure_ascii=False))}"


def rest_of_file(method: str, path: str) -> str:
    """Returns a line of a shell that sends a file to the service by curl, JSON as JSON."""
    sent = "--json" if path.endswith(DOCUMENTS) else "--data-binary"
    return f'curl -X {method} {AUTHORISED} "$TRUEUP_URL{path}" {sent} @FILE'
