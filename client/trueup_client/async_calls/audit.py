"""The calls of trueup_client.calls.audit for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

from collections.abc import AsyncIterator

from trueup_client.calls.audit import AuditCalls
from trueup_client.pool import Pooled
from trueup_client.proof import Checkpoint
from trueup_client.records import AuditEntry, Document
from trueup_client.witness import Witness


class AsyncAuditCalls(Pooled):
    """The audit log, and the service's readiness. For an event loop."""

    def audit(self, plant: str | None = None, after: int = 0) -> AsyncIterator[AuditEntry]:
        """Yields the entries of the log behind the sequence number `after`, in order."""
        return self._pool.each(AuditCalls.audit, plant, after)

    async def audit_key(self) -> str:
        """Returns the log's public key as the service gives it. Keep it."""
        return await self._pool.run(AuditCalls.audit_key)

    async def endorsements(self) -> list[str]:
        """Returns the notes by which keys of the log handed over to the next, in order."""
        return await self._pool.run(AuditCalls.endorsements)

    async def checkpoint(self) -> str:
        """Returns the log's signed head, as a note."""
        return await self._pool.run(AuditCalls.checkpoint)

    async def consistency(self, old: int, size: int) -> list[bytes]:
        """Returns the proof that the log of `size` entries extends the one of `old`."""
        return await self._pool.run(AuditCalls.consistency, old, size)

    async def inclusion(self, sequence: int, size: int) -> list[bytes]:
        """Returns the proof that an entry is in the log of `size` entries."""
        return await self._pool.run(AuditCalls.inclusion, sequence, size)

    async def witness(self, witness: Witness) -> Checkpoint:
        """Shows a witness the log as it is now. Raises NotSigned, LogForked."""
        return await self._pool.run(AuditCalls.witness, witness)

    def rows(self, table: str) -> AsyncIterator[Document]:
        """Yields the registry's rows of a table, as they are stored."""
        return self._pool.each(AuditCalls.rows, table)

    async def is_ready(self) -> bool:
        """Whether the service can do its work."""
        return await self._pool.run(AuditCalls.is_ready)
