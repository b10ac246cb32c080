"""Files that a job leaves behind beside its artifact, and entries of the log by their subject."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "outputs",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("job", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=63), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("media_type", sa.String(length=100), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_outputs_plant_plants")),
        sa.ForeignKeyConstraint(["job"], ["jobs.id"], name=op.f("fk_outputs_job_jobs")),
        sa.PrimaryKeyConstraint("job", "name", name=op.f("pk_outputs")),
    )
    op.create_index(op.f("ix_outputs_digest"), "outputs", ["digest"], unique=False)
    op.create_index(op.f("ix_audit_subject"), "audit", ["subject"], unique=False)
