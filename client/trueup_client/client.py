"""The client: one method for each thing that the service can be asked, typed."""

from __future__ import annotations

import os

from trueup_client.calls.access import AccessCalls
from trueup_client.calls.artifacts import ArtifactCalls
from trueup_client.calls.audit import AuditCalls
from trueup_client.calls.gates import GateCalls
from trueup_client.calls.jobs import JobCalls
from trueup_client.calls.labels import LabelCalls
from trueup_client.calls.monitoring import MonitoringCalls
from trueup_client.calls.plants import PlantCalls
from trueup_client.calls.serving import ServingCalls
from trueup_client.calls.webhooks import WebhookCalls
from trueup_client.connection import Connection

DEFAULT_PORT = "8321"


class Client(
    PlantCalls,
    ArtifactCalls,
    GateCalls,
    JobCalls,
    ServingCalls,
    LabelCalls,
    MonitoringCalls,
    AccessCalls,
    AuditCalls,
    WebhookCalls,
):
    """Talks to one service. Not for several threads at once: give each its own.

    `url` is its address (default: TRUEUP_URL, else this machine's at TRUEUP_PORT, else at 8321),
    `token` says who asks (default: TRUEUP_TOKEN), and `actor` stands in the audit log behind the
    token's name. Every call raises Problem if the service refuses, and Unreachable if it does not
    answer.
    """

    def __init__(
        self,
        url: str | None = None,
        actor: str | None = None,
        timeout_s: float = 120.0,
        token: str | None = None,
    ) -> None:
        here = f"http://127.0.0.1:{os.environ.get('TRUEUP_PORT', DEFAULT_PORT)}"
        address = url or os.environ.get("TRUEUP_URL") or here
        self._connection = Connection(
            address, actor, timeout_s, token or os.environ.get("TRUEUP_TOKEN")
        )

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection."""
        self._connection.close()

    def abort(self) -> None:
        """Closes the connection for good, from another thread.

        A call on its way ends with Unreachable, and nothing is asked again.
        """
        self._connection.abort()

    @property
    def aborted(self) -> bool:
        """Whether the connection was closed for good."""
        return self._connection.aborted
