"""What can go wrong, from the caller's side.

ClientError
├── Unreachable     nobody answered
├── DigestMismatch  the bytes are not what their digest names
├── NotSigned       a checkpoint or an envelope is not signed by the log's key
├── LogForked       the log does not extend the one that was seen before
└── Problem         the service refused; `code` is stable, `hint` says what to do next
"""

from __future__ import annotations

from typing import Any


class ClientError(Exception):
    """Talking to trueup failed."""


class Unreachable(ClientError):
    """The service did not answer."""


class DigestMismatch(ClientError):
    """What was received is not what its digest names, or is a list that has no end; it was thrown
    away."""


class NotSigned(ClientError):
    """What was received is not signed by the key of the log."""


class LogForked(ClientError):
    """The log or the pointer was rewritten.

    The log does not extend the one that this client has seen, or the pointer went back without a
    move.
    """


class Problem(ClientError):
    """The service refused a request, with an RFC 9457 problem document."""

    def __init__(self, status: int, document: dict[str, Any]) -> None:
        self.status = status
        self.code: str = document.get("code", "unknown")
        self.detail: str = document.get("detail", "")
        self.hint: str = document.get("hint", "")
        self.facts: dict[str, Any] = document.get("facts", {})
        self.request_id: str | None = document.get("request_id")
        super().__init__(f"{self.code}: {self.detail}")
        if self.hint:
            self.add_note(f"hint: {self.hint}")  # a traceback ends with it
