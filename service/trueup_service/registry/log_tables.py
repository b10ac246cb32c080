"""The tables of the audit log: its entries, its tree, its head and the keys that signed it."""

from __future__ import annotations

from sqlalchemy import BigInteger, Column, Index, Integer, LargeBinary, String, Table, Text

from trueup_service.registry.columns import AT, NAME, document, metadata

audit = Table(
    "audit",
    metadata,
    Column("sequence", BigInteger, primary_key=True, autoincrement=False),
    Column("at", AT, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("actor", Text, nullable=False),
    Column("plant", NAME),
    Column("subject", Text, nullable=False),
    document("facts"),
    document("rows"),
    Index(None, "plant", "sequence"),
    Index(None, "subject"),
)

audit_tree = Table(
    "audit_tree",
    metadata,
    Column("node", BigInteger, primary_key=True, autoincrement=False),
    Column("hash", LargeBinary(32), nullable=False),
)

audit_head = Table(
    "audit_head",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("size", BigInteger, nullable=False),
    Column("frontier", LargeBinary, nullable=False),
)

audit_key = Table(
    "audit_key",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("verifier", Text, nullable=False),
    Column("endorsement", Text),
)
