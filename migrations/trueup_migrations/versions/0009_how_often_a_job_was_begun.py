"""How often a job was begun, and how each attempt ended. Jobs that have not ended are found
quickly."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "attempts",
        sa.Column("entry", sa.String(120), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("worker", sa.Text(), nullable=False),
        sa.Column("begun_at", sa.String(27), nullable=False),
        sa.Column("ended", sa.Text(), nullable=True),
        sa.PrimaryKeyConstraint("entry", "number", name=op.f("pk_attempts")),
    )
    op.create_index(op.f("ix_attempts_begun_at"), "attempts", ["begun_at"])
    op.create_index(op.f("ix_jobs_state"), "jobs", ["state"])
