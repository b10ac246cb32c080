"""Exit codes: with what a command ends, and what that means."""

from __future__ import annotations

from collections.abc import Sequence

DONE, REFUSED, MISUSED, UNREACHABLE, DISAGREES, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 3, 4, 130, 141
MEANING = {
    DONE: "done",
    REFUSED: "refused: standard error says why, and what to do next",
    MISUSED: "misused",
    UNREACHABLE: "the service does not answer",
    DISAGREES: "bytes, a log or a decision are not what they were said to be",
    INTERRUPTED: "interrupted",
    PIPE_CLOSED: "nobody reads on",
}
HERE = (DONE, REFUSED, MISUSED)  # a command that asks nobody
ASKS = (*HERE, UNREACHABLE)  # one that asks the service
HOLDS_HERE = (*HERE, DISAGREES)  # one that holds bytes against what names them, here
HOLDS = (
    *ASKS,
    DISAGREES,
)  # one that holds what the service answers against what was seen of it before


def told(codes: Sequence[int]) -> str:
    """The same in a sentence."""
    return "Exit codes: " + "; ".join(f"{code} {MEANING[code]}" for code in codes) + "."
