"""The log as a Merkle tree, whose entries name every row; what was there before is named by one entry for each plant."""

import json
from datetime import UTC, datetime

import sqlalchemy as sa
from alembic import op

from trueup.canonical import canonical_bytes
from trueup.ledger.audit import AuditEntry, entry_bytes
from trueup.ledger.merkle import NOTHING, leaf_hash, number_of
from trueup.ledger.rows import row_digest, row_name
from trueup_service.registry.rows import plain

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

NAMED = (
    "plants", "episodes", "artifacts", "gates", "decisions", "moves", "serving", "monitors", "watching", "watches", "alarms",
    "policies", "evidence", "channels", "channel_moves", "jobs",
)  # fmt: skip
FINAL = ("succeeded", "failed", "cancelled")
FIELDS = ("sequence", "at", "kind", "actor", "plant", "subject")


def upgrade() -> None:
    with op.batch_alter_table("audit") as table:
        table.add_column(sa.Column("rows", sa.Text(), nullable=False, server_default="{}"))
        table.drop_column("previous")
        table.drop_column("digest")
    op.drop_table("audit_head")
    op.create_table(
        "audit_head",
        sa.Column("id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("size", sa.BigInteger(), nullable=False),
        sa.Column("frontier", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_head")),
    )
    op.create_table(
        "audit_tree",
        sa.Column("node", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("hash", sa.LargeBinary(length=32), nullable=False),
        sa.PrimaryKeyConstraint("node", name=op.f("pk_audit_tree")),
    )
    op.create_table(
        "audit_key",
        sa.Column("id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("verifier", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_key")),
    )
    _grow(op.get_bind())


def _grow(connection: sa.Connection) -> None:
    """Make the tree of the entries that there are, and one more for each plant that names its rows."""
    found = sa.MetaData()
    found.reflect(connection)
    audit, tree = found.tables["audit"], found.tables["audit_tree"]
    entries = [
        AuditEntry(**{name: row[name] for name in FIELDS}, facts=json.loads(row["facts"]), rows={})
        for row in connection.execute(sa.select(audit).order_by(audit.c.sequence)).mappings()
    ]
    of_plants: dict[str, dict[str, str]] = {}
    for table in (found.tables[name] for name in NAMED):
        for row in connection.execute(sa.select(table)).mappings():
            if table.name != "jobs" or row["state"] in FINAL:
                rows = of_plants.setdefault(row["name" if table.name == "plants" else "plant"], {})
                rows[row_name(table.name, row)] = row_digest(table.name, plain(table, row))
    at = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    for plant, rows in sorted(of_plants.items()):
        last = AuditEntry(len(entries) + 1, at, "log:migrated", "migration", plant, revision, {}, rows)
        told = {name: getattr(last, name) for name in FIELDS} | {"facts": "{}", "rows": canonical_bytes(rows).decode()}
        connection.execute(sa.insert(audit), told)
        entries.append(last)
    frontier = NOTHING
    for entry in entries:
        frontier, completed = frontier.append(leaf_hash(entry_bytes(entry)))
        nodes = [{"node": number_of(node), "hash": made} for node, made in completed.items()]
        connection.execute(sa.insert(tree), nodes)
    head = {"id": 1, "size": frontier.size, "frontier": frontier.to_bytes()}
    connection.execute(sa.insert(found.tables["audit_head"]), head)
