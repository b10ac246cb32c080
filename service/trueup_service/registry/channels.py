"""Channels of serving, and the evidence of artifacts that they require."""

from __future__ import annotations

from itertools import accumulate

from sqlalchemy import func, select, tuple_

from trueup_service.registry import tables as t
from trueup_service.registry.records import ChannelMove, ChannelRecord, EvidenceRecord
from trueup_service.registry.repository import Repository


class Channels(Repository[ChannelRecord]):
    """Declared channels."""

    table, record = t.channels, ChannelRecord

    def get(self, plant: str, name: str) -> ChannelRecord | None:
        """A channel of a plant by its name."""
        return self._by(plant=plant, name=name)

    def page(self, plant: str, after: str, limit: int) -> list[ChannelRecord]:
        """Channels by name from behind one."""
        return self._page(t.channels.c.name, after, limit, t.channels.c.plant == plant)


class ChannelMoves(Repository[ChannelMove]):
    """Every position that a channel has had."""

    table, record = t.channel_moves, ChannelMove

    def last(self, plant: str, channel: str) -> ChannelMove | None:
        """Where a channel stands, None where it never served."""
        return self._last("generation", plant=plant, channel=channel)


class EvidenceOfArtifacts(Repository[EvidenceRecord]):
    """Evidence of artifacts at the stages of the test ladder."""

    table, record = t.evidence, EvidenceRecord

    def get(self, plant: str, digest: str) -> EvidenceRecord | None:
        """Evidence by the digest of its document."""
        return self._by(plant=plant, digest=digest)

    def last_by_stage(self, plant: str, artifact: str) -> dict[str, tuple[str, bool]]:
        """The last evidence of an artifact at each stage: its digest, and whether it passed."""
        of = t.evidence.c
        query = (
            select(of.stage, of.digest, of.passed)
            .where(of.plant == plant, of.artifact == artifact)
            .order_by(of.created_at, of.digest)
        )
        return {row.stage: (row.digest, row.passed) for row in self._connection.execute(query)}

    def page(
        self, plant: str, artifact: str, after: tuple[str, str], limit: int, limit_bytes: int
    ) -> tuple[list[EvidenceRecord], bool]:
        """Evidence of an artifact in the order of time and digest from behind one, and whether
        there is more.

        At most `limit` of them, and of their documents at most `limit_bytes` together, except where
        the first one alone is longer.
        """
        key = tuple_(t.evidence.c.created_at, t.evidence.c.digest)
        of_artifact = t.evidence.c.plant == plant, t.evidence.c.artifact == artifact
        sizes = select(
            t.evidence.c.created_at, t.evidence.c.digest, func.length(t.evidence.c.document)
        ).where(*of_artifact, key > after)
        rows = self._connection.execute(sizes.order_by(*key.clauses).limit(limit + 1)).all()
        totals = accumulate(size for *_, size in rows)
        shown = rows[: max(1, min(limit, sum(size <= limit_bytes for size in totals)))]
        if not shown:
            return [], False
        last = tuple(shown[-1][:2])
        query = select(t.evidence).where(*of_artifact, key > after, key <= last)
        return self._all(query.order_by(*key.clauses)), len(shown) < len(rows)
