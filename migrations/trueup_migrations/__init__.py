"""The schema of the registry's database, change by change: one file each in `versions/`.

A change imports nothing that can change after it was released, so that it does tomorrow what it
does today.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sqlalchemy import Connection

HEAD = "0012"
FOLDER = Path(__file__).parent


def upgrade(connection: Connection, to: str = "head") -> None:
    """Run the changes that a database lacks, up to one of them. Raises
    sqlalchemy.exc.SQLAlchemyError."""
    from alembic import command  # noqa: PLC0415  (slow to load, and an up-to-date database needs none of it)
    from alembic.config import Config  # noqa: PLC0415

    config = Config()
    config.set_main_option("script_location", str(FOLDER))
    config.attributes["connection"] = connection
    command.upgrade(config, to)
