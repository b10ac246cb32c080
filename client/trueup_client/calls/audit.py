"""Calls on the audit log, its keys and its proofs, and on the service's readiness."""

from __future__ import annotations

import base64
from collections.abc import Iterator

from trueup_client.problem import Problem
from trueup_client.proof import Checkpoint
from trueup_client.records import AuditEntry, Document
from trueup_client.transport import Transport, url_path
from trueup_client.witness import Witness


class AuditCalls(Transport):
    """The audit log, and the service's readiness."""

    def audit(self, plant: str | None = None, after: int = 0) -> Iterator[AuditEntry]:
        """Yields the entries of the log behind the sequence number `after`, in order."""
        return self._pages(url_path("audit"), "after", after=str(after), plant=plant or None)

    def audit_key(self) -> str:
        """Returns the log's public key as the service gives it. Keep it."""
        return self._text(url_path("audit", "key")).strip()

    def endorsements(self) -> list[str]:
        """Returns the notes by which keys of the log handed over to the next, in order."""
        keys = self._get(url_path("audit", "keys"))["items"]
        return [key["endorsement"] for key in keys if key["endorsement"]]

    def checkpoint(self) -> str:
        """Returns the log's signed head, as a note."""
        return self._text(url_path("audit", "checkpoint"))

    def consistency(self, old: int, size: int) -> list[bytes]:
        """Returns the proof that the log of `size` entries extends the one of `old`."""
        return _hashes(self._get(url_path("audit", "consistency", old=old, size=size)))

    def inclusion(self, sequence: int, size: int) -> list[bytes]:
        """Returns the proof that an entry is in the log of `size` entries."""
        return _hashes(self._get(url_path("audit", "inclusion", sequence=sequence, size=size)))

    def witness(self, witness: Witness) -> Checkpoint:
        """Shows a witness the log as it is now. Raises NotSigned, LogForked."""
        if witness.key is None:
            witness.pin(self.audit_key())
        return witness.see(self.checkpoint(), self.consistency, self.endorsements)

    def rows(self, table: str) -> Iterator[Document]:
        """Yields the registry's rows of a table, as they are stored."""
        return self._pages(url_path("audit", "rows", table), "after", limit="1000")

    def is_ready(self) -> bool:
        """Whether the service can do its work."""
        try:
            return bool(self._get("/readyz")["ready"])
        except Problem:
            return False


def _hashes(proof: Document) -> list[bytes]:
    return [base64.b64decode(h) for h in proof["hashes"]]
