"""The schema of the database: brought up to date, and held against the tables."""

from __future__ import annotations

from sqlalchemy import insert, inspect, text
from sqlalchemy.exc import OperationalError, ProgrammingError

from trueup.ledger.verification import Finding
from trueup_migrations import HEAD, upgrade
from trueup_service.errors import NotWhole
from trueup_service.registry import tables as t
from trueup_service.registry.database import Database

SQLITE_TRIGGERS = "SELECT name, tbl_name FROM sqlite_master WHERE type = 'trigger'"
POSTGRES_TRIGGERS = (
    "SELECT tgname, relname FROM pg_trigger JOIN pg_class ON pg_class.oid = tgrelid WHERE "
    "NOT tgisinternal AND pg_table_is_visible(tgrelid)"
)
ADVISORY_LOCK = 0x7472756575  # "trueu": one migration at a time among many servers


def migrate(database: Database) -> None:
    """Run the migrations that are missing.

    The migration tool loads slowly, so it is not loaded where the schema is up to date or the
    database is empty. Raises NotWhole where the database is not what its version says.
    """
    before = current(database)
    if before == HEAD or _create(database):
        return
    with database.write() as connection:
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": ADVISORY_LOCK})
        try:
            upgrade(connection)
        except (OperationalError, ProgrammingError) as error:
            raise NotWhole(
                f"the database says that its schema is {before}, and cannot be brought from "
                f"there to {HEAD}: {error.orig}"
            ) from error


def _create(database: Database) -> bool:
    """Make the tables of an empty database at once, as the migrations would. Returns False where
    there are tables already."""
    with database.write() as connection:
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": ADVISORY_LOCK})
        if inspect(connection).get_table_names():
            return False
        t.metadata.create_all(connection)
        connection.execute(insert(t.audit_head), {"id": 1, "size": 0, "frontier": b""})
        connection.execute(
            text("CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL PRIMARY KEY)")
        )
        connection.execute(text("INSERT INTO alembic_version VALUES (:head)"), {"head": HEAD})
    return True


def altered(database: Database) -> list[Finding]:
    """Where tables lack their primary key, or have a trigger.

    Without its key a table takes two rows of one name, and a trigger changes rows by itself.
    """
    findings: list[Finding] = []
    with database.read() as connection:
        inspector = inspect(connection)
        for table in t.metadata.sorted_tables:
            key = [column.name for column in table.primary_key.columns]
            if not inspector.has_table(table.name) or set(
                inspector.get_pk_constraint(table.name)["constrained_columns"]
            ) != set(key):
                findings.append(
                    Finding(table.name, f"it is no table with the key {', '.join(key)}")
                )
        for name, table_name in connection.execute(
            text(SQLITE_TRIGGERS if database.is_sqlite else POSTGRES_TRIGGERS)
        ):
            if table_name in t.metadata.tables:
                findings.append(Finding(str(table_name), f"it has a trigger, {name}"))
    return findings


def current(database: Database) -> str | None:
    """The version of the schema, None for an empty database."""
    with database.read() as connection:
        if not inspect(connection).has_table("alembic_version"):
            return None
        return str(connection.scalar(text("SELECT version_num FROM alembic_version")))
