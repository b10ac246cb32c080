"""What people call plants, episodes, versions and decisions: a name, tags and a note."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "labels",
        sa.Column("plant", sa.String(63), nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("subject", sa.String(64), nullable=False),
        sa.Column("name", sa.Text(), nullable=True),
        sa.Column("tags", sa.Text(), nullable=False),
        sa.Column("note", sa.Text(), nullable=True),
        sa.Column("updated_at", sa.String(27), nullable=False),
        sa.Column("updated_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_labels_plant")),
        sa.PrimaryKeyConstraint("plant", "kind", "subject", name=op.f("pk_labels")),
    )
    op.create_index(op.f("ix_labels_kind_plant"), "labels", ["kind", "plant"])
    for column in ("created_at", "start_ns"):  # by which a list of episodes is sorted
        name = op.f(f"ix_episodes_plant_{column}")
        op.create_index(name, "episodes", ["plant", column])
