"""What the tables of the registry are made of: types of columns, and columns that several have."""

from __future__ import annotations

from sqlalchemy import Column, ForeignKey, MetaData, String, Text

NAME, DIGEST, ID, AT = String(63), String(64), String(32), String(27)

DOCUMENT = "document"  # marks a column of JSON text

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
    }
)


def created() -> tuple[Column[str], Column[str]]:
    """When and by whom a row was made."""
    return Column("created_at", AT, nullable=False), Column("created_by", Text, nullable=False)


def acted() -> tuple[Column[str], Column[str]]:
    """When something was done, and by whom."""
    return Column("at", AT, nullable=False), Column("actor", Text, nullable=False)


def plant_column(*, primary_key: bool = False) -> Column[str]:
    """The plant that a row belongs to."""
    return Column("plant", NAME, ForeignKey("plants.name"), primary_key=primary_key, nullable=False)


def document(name: str, *, nullable: bool = False) -> Column[str]:
    """A column that holds a document as canonical JSON."""
    return Column(name, Text, nullable=nullable, info={DOCUMENT: True})
