"""Attempts at jobs and at parts of jobs, by the name of their entry in the job engine. The log does
not name them, and they are kept for a time only: they say how long jobs of a kind take."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import delete, func, insert, select, update

from trueup_service.registry import tables as t
from trueup_service.registry.repository import TableGateway

IN_ORDER = "in order"  # how an attempt ended that does not count
FINISHED = "finished"  # how the last attempt at a job ended, whatever came of it


@dataclass(frozen=True, slots=True)
class AttemptRecord:
    """One attempt: which worker began it, when, and how it ended; None while it is under way, and
    where its worker died."""

    entry: str
    number: int
    worker: str
    begun_at: str
    ended: str | None


class Attempts:
    """Attempts by entry."""

    def __init__(self, gateway: TableGateway) -> None:
        self._connection = gateway.connection

    def of(self, entry: str) -> list[AttemptRecord]:
        """The attempts at an entry, in their order."""
        query = select(t.attempts).where(t.attempts.c.entry == entry).order_by(t.attempts.c.number)
        return [AttemptRecord(**row) for row in self._connection.execute(query).mappings()]

    def begin(self, entry: str, worker: str, now: str) -> list[AttemptRecord]:
        """Note that a worker begins an attempt, unless it is at one already. Returns the attempts
        before it at which a process or a worker died."""
        attempts = self.of(entry)
        open_ = [a for a in attempts if a.ended is None and a.worker == worker]
        if not open_:
            self._connection.execute(
                insert(t.attempts).values(
                    entry=entry, number=len(attempts) + 1, worker=worker, begun_at=now
                )
            )
        return [a for a in attempts if a not in open_ and a.ended != IN_ORDER]

    def end(self, entry: str, worker: str, how: str) -> None:
        """Note how the attempt ended that a worker is at."""
        of = t.attempts.c
        self._connection.execute(
            update(t.attempts)
            .where(of.entry == entry, of.worker == worker, of.ended.is_(None))
            .values(ended=how)
        )

    def finish(self, entry: str) -> None:
        """Note that the last attempt at an entry was the one that finished it."""
        of = t.attempts.c
        last = select(func.max(of.number)).where(of.entry == entry).scalar_subquery()
        self._connection.execute(
            update(t.attempts)
            .where(of.entry == entry, of.number == last, of.ended.is_(None))
            .values(ended=FINISHED)
        )

    def end_all(self, worker: str) -> None:
        """Note that the attempts of a worker that is being stopped end in order."""
        of = t.attempts.c
        self._connection.execute(
            update(t.attempts).where(of.worker == worker, of.ended.is_(None)).values(ended=IN_ORDER)
        )

    def forget(self, entry: str) -> None:
        """Delete the attempts at an entry."""
        self._connection.execute(delete(t.attempts).where(t.attempts.c.entry == entry))

    def forget_before(self, before: str) -> None:
        """Delete attempts that began before a time."""
        self._connection.execute(delete(t.attempts).where(t.attempts.c.begun_at < before))
