"""Bring the database's schema up to date."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import insert, inspect, text

from trueup_service.registry import tables as t
from trueup_service.registry.database import Database

HEAD = "0008"
MIGRATIONS = Path(__file__).parent.parent / "migrations"
ADVISORY_LOCK = 0x7472756575  # "trueu": one migration at a time among many servers


def migrate(database: Database) -> None:
    """Run the migrations that are missing. An up-to-date schema costs one query, for the migration tool loads slowly."""
    if current(database) == HEAD or _made(database):
        return
    from alembic import command  # noqa: PLC0415
    from alembic.config import Config  # noqa: PLC0415

    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    with database.write() as connection:
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": ADVISORY_LOCK})
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def _made(database: Database) -> bool:
    """Make the tables of an empty database at once, as the migrations would; False where there is something already."""
    with database.write() as connection:
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": ADVISORY_LOCK})
        if inspect(connection).get_table_names():
            return False
        t.metadata.create_all(connection)
        connection.execute(insert(t.audit_head), {"id": 1, "size": 0, "frontier": b""})
        connection.execute(text("CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL PRIMARY KEY)"))
        connection.execute(text("INSERT INTO alembic_version VALUES (:head)"), {"head": HEAD})
    return True


def current(database: Database) -> str | None:
    """The schema's version, None for an empty database."""
    with database.read() as connection:
        if not inspect(connection).has_table("alembic_version"):
            return None
        return str(connection.scalar(text("SELECT version_num FROM alembic_version")))
