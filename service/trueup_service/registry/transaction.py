"""A transaction on the registry: one repository for each noun, and the log that tells of all that
was written.

Nothing here updates or deletes an episode, an artifact, a gate, a decision, a move or an entry of
the log. Only a job's progress, the generation that serves, where a monitor or a webhook stands,
what people call things, and whether a token is revoked, an alarm is open or a webhook is removed
change.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy import Connection, text

from trueup.errors import BrokenChain
from trueup_service.registry.artifacts import Artifacts
from trueup_service.registry.attempts import Attempts
from trueup_service.registry.audit_log import AuditLog
from trueup_service.registry.channels import ChannelMoves, Channels, EvidenceOfArtifacts
from trueup_service.registry.database import Database
from trueup_service.registry.decisions import Approvals, Decisions
from trueup_service.registry.episodes import Episodes
from trueup_service.registry.gates import Gates, Policies
from trueup_service.registry.idempotency import Idempotency
from trueup_service.registry.jobs import Jobs, Outputs
from trueup_service.registry.labels import Labels
from trueup_service.registry.monitors import Alarms, Monitors, Watches
from trueup_service.registry.plants import Plants, Projects
from trueup_service.registry.repository import TableGateway
from trueup_service.registry.serving import Serving
from trueup_service.registry.stored_rows import Imports, StoredRows
from trueup_service.registry.tokens import Sessions, Tokens
from trueup_service.registry.webhooks import WebhookCursors, Webhooks

_LOCK_NAME = text("SELECT pg_advisory_xact_lock(hashtextextended(:name, 0))")


class ReadTransaction:
    """The registry as one transaction sees it. Its repositories refuse to write."""

    writable = False

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._gateway = gateway = TableGateway(connection, writable=self.writable)
        self.log = AuditLog(gateway)
        self.plants, self.projects = Plants(gateway), Projects(gateway)
        self.tokens, self.sessions = Tokens(gateway), Sessions(gateway)
        self.episodes, self.labels = Episodes(gateway), Labels(gateway)
        self.artifacts = Artifacts(gateway)
        self.gates, self.policies = Gates(gateway, self.log), Policies(gateway)
        self.decisions, self.approvals = Decisions(gateway), Approvals(gateway)
        self.serving = Serving(gateway)
        self.channels, self.channel_moves = Channels(gateway), ChannelMoves(gateway)
        self.evidence = EvidenceOfArtifacts(gateway)
        self.jobs, self.outputs = Jobs(gateway), Outputs(gateway)
        self.attempts = Attempts(gateway)
        self.monitors, self.watches = Monitors(gateway), Watches(gateway)
        self.alarms = Alarms(gateway)
        self.webhooks = Webhooks(gateway)
        self.webhook_cursors = WebhookCursors(gateway)
        self.idempotency = Idempotency(gateway)
        self.imports, self.rows = Imports(gateway), StoredRows(gateway)


class Transaction(ReadTransaction):
    """A transaction that writes. Every row that it adds or changes is named, by digest, in the next
    entry of the log."""

    writable = True

    def lock_name(self, name: str) -> None:
        """Make every other writer that locks this name wait until the commit, where there is no row
        to lock yet.

        On SQLite every writer holds all others from its beginning, and nothing is left to do.
        """
        if self.connection.dialect.name != "sqlite":
            self.connection.execute(_LOCK_NAME, {"name": name})

    def require_logged(self) -> None:
        """Raises BrokenChain where a row was written that no entry of the log names."""
        if self._gateway.unlogged:
            raise BrokenChain(f"no entry of the log tells of {', '.join(self._gateway.unlogged)}")


@contextmanager
def reading(database: Database) -> Iterator[ReadTransaction]:
    """A transaction that reads a consistent state."""
    with database.read() as connection:
        yield ReadTransaction(connection)


@contextmanager
def writing(database: Database) -> Iterator[Transaction]:
    """A transaction that commits when it is left without an error. Raises BrokenChain, and rolls
    back, where the log does not tell of all that was written."""
    with database.write() as connection:
        transaction = Transaction(connection)
        yield transaction
        transaction.require_logged()
