"""Plants, and the projects that they belong to."""

from __future__ import annotations

from sqlalchemy import bindparam, select

from trueup_service.registry import tables as t
from trueup_service.registry.records import PlantRecord, ProjectRecord
from trueup_service.registry.repository import Repository

_DIGEST = select(t.plants.c.digest).where(t.plants.c.name == bindparam("plant"))
_LOCK = select(t.plants.c.name).where(t.plants.c.name == bindparam("plant")).with_for_update()


class Plants(Repository[PlantRecord]):
    """Registered plants."""

    table, record = t.plants, PlantRecord

    def get(self, name: str) -> PlantRecord | None:
        """A plant by its name."""
        return self._by(name=name)

    def digest(self, name: str) -> str | None:
        """The digest of a plant's description, read without the description."""
        digest: str | None = self._connection.scalar(_DIGEST, {"plant": name})
        return digest

    def page(self, after: str, limit: int, project: str | None = None) -> list[PlantRecord]:
        """Plants by name from behind one, of one project or of all."""
        where = () if project is None else (t.plants.c.project == project,)
        return self._page(t.plants.c.name, after, limit, *where)

    def is_in_project(self, plant: str, project: str) -> bool:
        """Whether a plant exists and belongs to this project."""
        query = select(t.plants.c.project).where(t.plants.c.name == plant)
        return bool(self._connection.scalar(query) == project)

    def lock(self, plant: str) -> None:
        """Make every other writer of this plant wait until the commit.

        On SQLite every writer holds all others from its beginning, and nothing is left to do.
        """
        if self._connection.dialect.name != "sqlite":
            self._connection.execute(_LOCK, {"plant": plant})


class Projects(Repository[ProjectRecord]):
    """Projects of plants."""

    table, record = t.projects, ProjectRecord

    def get(self, name: str) -> ProjectRecord | None:
        """A project by its name."""
        return self._by(name=name)

    def page(self, after: str, limit: int) -> list[ProjectRecord]:
        """Projects by name from behind one."""
        return self._page(t.projects.c.name, after, limit)
