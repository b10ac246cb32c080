"""Artifacts: the versions of a plant's model."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import bindparam, func, select

from trueup_service.registry import tables as t
from trueup_service.registry.records import ArtifactRecord
from trueup_service.registry.repository import Repository

_LATEST_VERSION = select(func.max(t.artifacts.c.version)).where(
    t.artifacts.c.plant == bindparam("plant")
)
_NUMBERS = select(t.artifacts.c.digest, t.artifacts.c.version).where(
    t.artifacts.c.plant == bindparam("of_plant"),
    t.artifacts.c.digest.in_(bindparam("digests", expanding=True)),
)


class Artifacts(Repository[ArtifactRecord]):
    """Versions of models."""

    table, record = t.artifacts, ArtifactRecord

    def get(self, plant: str, digest: str) -> ArtifactRecord | None:
        """An artifact of a plant by the digest of its manifest."""
        return self._by(plant=plant, digest=digest)

    def by_version(self, plant: str, version: int) -> ArtifactRecord | None:
        """An artifact of a plant by its version."""
        return self._by(plant=plant, version=version)

    def page(self, plant: str, after: int, limit: int) -> list[ArtifactRecord]:
        """Artifacts in the order of their versions from behind one."""
        return self._page(t.artifacts.c.version, after, limit, t.artifacts.c.plant == plant)

    def newest_of_kind(self, plant: str, kind: str) -> ArtifactRecord | None:
        """The newest artifact of a plant whose model is of a kind."""
        return self._last("version", plant=plant, kind=kind)

    def numbers(self, plant: str, digests: Sequence[str]) -> dict[str, int]:
        """The numbers of some versions of a plant, by digest."""
        rows = self._gateway.in_parts(_NUMBERS, "digests", digests, {"of_plant": plant})
        return {str(row.digest): int(row.version) for row in rows}

    def latest_version(self, plant: str) -> int:
        """The highest version of a plant, 0 where there is none."""
        return int(self._connection.scalar(_LATEST_VERSION, {"plant": plant}) or 0)
