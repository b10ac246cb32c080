"""The exit codes of commands, and what they mean."""

from __future__ import annotations

from collections.abc import Sequence

DONE, REFUSED, MISUSED, UNREACHABLE, DISAGREES, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 3, 4, 130, 141
MEANING = {
    DONE: "done",
    REFUSED: "refused: standard error says why, and what to do next",
    MISUSED: "wrong command line",
    UNREACHABLE: "the service does not answer",
    DISAGREES: "bytes, a log or a decision do not match their digest",
    INTERRUPTED: "interrupted",
    PIPE_CLOSED: "the reader of the output has closed the pipe",
}
LOCAL = (DONE, REFUSED, MISUSED)  # a command that asks no service
CALLS_SERVICE = (*LOCAL, UNREACHABLE)
VERIFIES_LOCALLY = (*LOCAL, DISAGREES)  # one that checks bytes against what names them
VERIFIES = (*CALLS_SERVICE, DISAGREES)  # one that checks the service's answers against its log


def exit_codes(codes: Sequence[int]) -> str:
    """Returns the sentence that lists these exit codes, for a command's help."""
    return "Exit codes: " + "; ".join(f"{code} {MEANING[code]}" for code in codes) + "."
