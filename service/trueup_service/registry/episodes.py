"""Episodes of a plant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from sqlalchemy import Select, func, select

from trueup.episode.role import HELD_OUT
from trueup_service.registry import tables as t
from trueup_service.registry.records import EpisodeRecord, Watching
from trueup_service.registry.repository import Repository


class Episodes(Repository[EpisodeRecord]):
    """Ingested episodes."""

    table, record = t.episodes, EpisodeRecord

    def get(self, plant: str, digest: str) -> EpisodeRecord | None:
        """An episode of a plant by the digest of its bytes."""
        return self._by(plant=plant, digest=digest)

    def names(self, plant: str, digests: Iterable[str]) -> dict[str, str]:
        """What some episodes are called by their condition `recording`, by digest; without those
        that have none."""
        query = select(t.episodes).where(
            t.episodes.c.plant == plant, t.episodes.c.digest.in_(list(digests))
        )
        conditions = ((e.digest, e.summary.get("conditions") or {}) for e in self._all(query))
        return {
            digest: str(of["recording"])
            for digest, of in conditions
            if isinstance(of, Mapping) and of.get("recording")
        }

    def page(self, plant: str, role: str | None, after: str, limit: int) -> list[EpisodeRecord]:
        """Episodes in the order of their digests from behind one, of one role or of all."""
        of_role = () if role is None else (t.episodes.c.role == role,)
        of_plant = t.episodes.c.plant == plant
        return self._page(t.episodes.c.digest, after, limit, of_plant, *of_role)

    def of_roles(
        self,
        plant: str,
        roles: Iterable[str],
        since_ns: int | None = None,
        ingested_after: str = "",
    ) -> list[EpisodeRecord]:
        """Every episode of some roles in the order of their start.

        Only those that came in after the time `ingested_after`, and unless `since_ns` is None only
        those whose recording starts at that time or later [ns].
        """
        query = select(t.episodes).where(
            t.episodes.c.plant == plant,
            t.episodes.c.role.in_(list(roles)),
            t.episodes.c.created_at > ingested_after,
        )
        query = query if since_ns is None else query.where(t.episodes.c.start_ns >= since_ns)
        return self._all(query.order_by(t.episodes.c.start_ns, t.episodes.c.digest))

    def newest_of_role(self, plant: str, role: str) -> str | None:
        """When the newest episode of a role came in, None where there is none."""
        of = t.episodes.c
        query = select(func.max(of.created_at)).where(of.plant == plant, of.role == role)
        newest: str | None = self._connection.scalar(query)
        return newest

    def samples_of_role(self, plant: str, role: str) -> set[str]:
        """The digests of the samples of every episode of a role, where they are known."""
        of = t.episodes.c
        query = select(of.samples_digest).where(
            of.plant == plant, of.role == role, of.samples_digest.is_not(None)
        )
        return set(self._connection.scalars(query))

    def count_of_role(self, plant: str, *roles: str) -> int:
        """How many episodes of some roles a plant has."""
        query = (
            select(func.count())
            .select_from(t.episodes)
            .where(t.episodes.c.plant == plant, t.episodes.c.role.in_(roles))
        )
        return int(self._connection.scalar(query) or 0)

    def count_held_out(self, plant: str) -> int:
        """How many held-out episodes a plant has."""
        return self.count_of_role(plant, *HELD_OUT)

    def with_equal_samples(self, digest: str, plant: str | None = None) -> set[str]:
        """The digests of the episodes that hold the samples of this one, of one plant or of any.
        The digest itself is always among them."""
        query = equal_samples(digest)
        query = query if plant is None else query.where(t.episodes.c.plant == plant)
        return {digest, *self._connection.scalars(query)}

    def unwatched(
        self, watching: Watching, roles: Iterable[str], limit: int
    ) -> list[EpisodeRecord]:
        """Episodes that came in since a monitor began to watch and that it has not seen, in the
        order of their start."""
        seen = select(t.watches.c.episode).where(
            t.watches.c.plant == watching.plant,
            t.watches.c.monitor == watching.monitor,
            t.watches.c.episode == t.episodes.c.digest,
        )
        query = select(t.episodes).where(
            t.episodes.c.plant == watching.plant,
            t.episodes.c.role.in_(list(roles)),
            t.episodes.c.created_at >= watching.since,
            ~seen.exists(),
        )
        return self._all(query.order_by(t.episodes.c.start_ns, t.episodes.c.digest).limit(limit))


def equal_samples(digest: str) -> Select[Any]:
    """Selects the digests of the episodes whose samples are those of this one."""
    samples = select(t.episodes.c.samples_digest).where(t.episodes.c.digest == digest)
    return select(t.episodes.c.digest).where(t.episodes.c.samples_digest.in_(samples))
