"""Errors as a command prints them: what went wrong, and what to do next."""

from __future__ import annotations

import errno
import sys
import traceback
from collections.abc import Mapping

from trueup.errors import TrueupError
from trueup_cli.exits import DISAGREES, REFUSED, UNREACHABLE
from trueup_cli.show import as_json, err, lines, say
from trueup_client.problem import ClientError, DigestMismatch, LogForked, NotSigned, Problem

UNTRUE_HINT = (
    "The bytes are not what their digest names: the stored copy is damaged, or was changed."
)
REWRITTEN_HINT = (
    "Ask whoever runs the service what happened to its database, and compare mirrors of its "
    "checkpoint; if it was made anew on purpose, "
    "remove the named file."
)
SHOWN = 200  # characters of a fact that are printed
PATH_HINT = "Check the path; it is looked for from the folder in which the command runs."
PORT_HINT = "Choose another with --port, or use the service that listens there already."
HINTS = {  # where the service's hint is for programs, what to do at the command
    ("not-found", "plant"): "`trueup plant list` says which there are.",
    ("not-found", "artifact"): "`trueup versions PLANT` lists them.",
    ("not-found", "decision"): "`trueup decisions PLANT` lists them.",
    ("unauthenticated", ""): (
        "Sign in with `trueup login`, set TRUEUP_TOKEN, or run the command in the folder in "
        "which the service was started (or with its "
        "TRUEUP_DATA_DIR), where it finds the first admin's token."
    ),
}
DAMAGED = ("blob-damaged", "broken-chain")  # codes by which a service reports its own storage
SERVER_PARTS = ("trueup_service", "trueup_worker", "trueup_migrations")
NO_SERVER_HINT = (
    "Install it with `pip install 'trueup-cli[server]'`, or use the command with a service "
    "that runs elsewhere (--url)."
)
UNREACHABLE_HINT = "Start it with `trueup serve`, or name it with --url or TRUEUP_URL."


def print_traceback(error: Exception) -> int:
    """Prints an unexpected error with its traceback, escaped, and returns Python's exit code."""
    lines("".join(traceback.format_exception(error)), to=err)
    return REFUSED


def print_error(error: Exception) -> int | None:
    """Prints an error of ours and returns the exit code; None for any other error."""
    code = UNREACHABLE if isinstance(error, ClientError) else REFUSED
    facts: Mapping[str, object] = {}
    if isinstance(error, Problem):
        code = DISAGREES if error.code in DAMAGED else REFUSED
        noun = str(error.facts.get("noun", ""))
        facts = {name: value for name, value in error.facts.items() if name != "noun"}
        message = error.code, error.detail, HINTS.get((error.code, noun), error.hint)
    elif isinstance(error, DigestMismatch):
        message, code = ("untrue", str(error), UNTRUE_HINT), DISAGREES
    elif isinstance(error, NotSigned | LogForked):
        name = "not-signed" if isinstance(error, NotSigned) else "rewritten"
        message, code = (name, str(error), REWRITTEN_HINT), DISAGREES
    elif isinstance(error, ClientError):
        message = "unreachable", str(error), UNREACHABLE_HINT
    elif isinstance(error, TrueupError):
        message, facts = (error.code, error.message, error.hint), error.facts
    elif (
        isinstance(error, ModuleNotFoundError) and str(error.name).partition(".")[0] in SERVER_PARTS
    ):
        message = (
            "not-installed",
            f"this command runs the service, and {error.name} is not installed",
            NO_SERVER_HINT,
        )
    elif isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
        message = "address-in-use", str(error.strerror), PORT_HINT
    elif isinstance(error, OSError) and error.filename is not None:
        message = "file", f"{error.strerror}: {error.filename}", PATH_HINT
    else:
        return None
    _print(*message, facts, getattr(error, "request_id", None))
    return code


def _print(
    code: str, detail: str, hint: str, facts: Mapping[str, object], request_id: str | None
) -> None:
    """Prints in words on standard error; with --json as a problem document on standard output."""
    known = {name: x for name, x in facts.items() if x is not None}
    if "--json" in sys.argv:
        as_json(
            {"code": code, "detail": detail, "hint": hint, "facts": known, "request_id": request_id}
        )
        return
    say("[bold red]{}[/] {}", code, detail, to=err)
    if hint:
        say("  {}", hint, to=err)
    for name, x in known.items():
        if isinstance(x, str | int | float) and str(x) not in detail:
            say("  [dim]{}[/] {}", name, str(x)[:SHOWN], to=err)
    if request_id:
        say("  [dim]request {}[/]", request_id, to=err)
