"""What went wrong, for whoever sits at the command, with what to do next."""

from __future__ import annotations

from rich.markup import escape

from trueup.errors import TrueupError
from trueup_cli.exits import DISAGREES, REFUSED, UNREACHABLE
from trueup_cli.show import err
from trueup_client.problem import ClientError, NotSigned, Problem, Rewritten, Untrue

UNTRUE_HINT = "The bytes are not what their digest names: the stored copy is damaged, or was changed."
REWRITTEN_HINT = (
    "Ask whoever runs the service what happened to its database, and compare mirrors of its checkpoint; if it was made anew on purpose, "
    "remove the named file."
)
UNREACHABLE_HINT = "Start it with `trueup serve`, or name it with --url or TRUEUP_URL."


def complain(error: Exception) -> int | None:
    """Print an error of ours and give the exit code; None for one that is not ours."""
    if isinstance(error, Problem):
        _print(error.code, error.detail, error.hint, error.request_id)
        return REFUSED
    if isinstance(error, Untrue):
        _print("untrue", str(error), UNTRUE_HINT)
        return DISAGREES
    if isinstance(error, NotSigned | Rewritten):
        _print("not-signed" if isinstance(error, NotSigned) else "rewritten", str(error), REWRITTEN_HINT)
        return DISAGREES
    if isinstance(error, ClientError):
        _print("unreachable", str(error), UNREACHABLE_HINT)
        return UNREACHABLE
    if isinstance(error, TrueupError):
        _print(error.code, error.message, error.hint)
        return REFUSED
    return None


def _print(code: str, detail: str, hint: str, request_id: str | None = None) -> None:
    err.print(f"[bold red]{escape(code)}[/] {escape(detail)}", soft_wrap=True)
    if hint:
        err.print(f"  {escape(hint)}", soft_wrap=True)
    if request_id:
        err.print(f"  [dim]request {request_id}[/]")
