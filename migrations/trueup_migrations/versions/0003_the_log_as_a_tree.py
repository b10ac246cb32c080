"""The log as a Merkle tree, whose entries name every row; what was there before is named by one
entry for each plant."""

import json
from datetime import UTC, datetime

import sqlalchemy as sa
from alembic import op

from trueup_migrations.log_of_0003 import append, canonical, leaf, row_digest, row_name

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

NAMED = (
    "plants", "episodes", "artifacts", "gates", "decisions", "moves", "serving", "monitors",
    "watching", "watches", "alarms",
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
    """Make the tree of the entries that there are, and one more for each plant that names its
    rows."""
    reflected = sa.MetaData()
    reflected.reflect(connection)
    audit, tree = reflected.tables["audit"], reflected.tables["audit_tree"]
    entries = [
        ({name: row[name] for name in FIELDS}, json.loads(row["facts"]), {})
        for row in connection.execute(sa.select(audit).order_by(audit.c.sequence)).mappings()
    ]
    of_plants: dict[str, dict[str, str]] = {}
    for table in (reflected.tables[name] for name in NAMED):
        for row in connection.execute(sa.select(table)).mappings():
            if table.name != "jobs" or row["state"] in FINAL:
                rows = of_plants.setdefault(row["name" if table.name == "plants" else "plant"], {})
                rows[row_name(table.name, row)] = row_digest(table, row)
    at = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    for plant, rows in sorted(of_plants.items()):
        added = {
            "sequence": len(entries) + 1,
            "at": at,
            "kind": "log:migrated",
            "actor": "migration",
            "plant": plant,
            "subject": revision,
        }
        connection.execute(
            sa.insert(audit), added | {"facts": "{}", "rows": canonical(rows).decode()}
        )
        entries.append((added, {}, rows))
    frontier: list[bytes] = []
    for size, (entry, facts, rows) in enumerate(entries):
        nodes = [
            {"node": number, "hash": hashed}
            for number, hashed in append(frontier, size, leaf(entry, facts, rows)).items()
        ]
        connection.execute(sa.insert(tree), nodes)
    connection.execute(
        sa.insert(reflected.tables["audit_head"]),
        {"id": 1, "size": len(entries), "frontier": b"".join(frontier)},
    )
