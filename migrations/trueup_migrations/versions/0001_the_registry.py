"""The registry."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "audit",
        sa.Column("sequence", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("at", sa.String(length=27), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("plant", sa.String(length=63), nullable=True),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column("facts", sa.Text(), nullable=False),
        sa.Column("previous", sa.String(length=64), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.PrimaryKeyConstraint("sequence", name=op.f("pk_audit")),
    )
    op.create_index(op.f("ix_audit_plant_sequence"), "audit", ["plant", "sequence"], unique=False)
    op.create_table(
        "audit_head",
        sa.Column("id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("sequence", sa.BigInteger(), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_head")),
    )
    op.create_table(
        "idempotency",
        sa.Column("scope", sa.String(length=160), nullable=False),
        sa.Column("key", sa.String(length=255), nullable=False),
        sa.Column("request_digest", sa.String(length=64), nullable=False),
        sa.Column("response", sa.Text(), nullable=False),
        sa.Column("at", sa.String(length=27), nullable=False),
        sa.PrimaryKeyConstraint("scope", "key", name=op.f("pk_idempotency")),
    )
    op.create_table(
        "plants",
        sa.Column("name", sa.String(length=63), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_plants")),
    )
    op.create_table(
        "artifacts",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("version", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("manifest", sa.Text(), nullable=False),
        sa.Column("arrays", sa.String(length=64), nullable=True),
        sa.Column("job", sa.String(length=32), nullable=True),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_artifacts_plant")),
        sa.PrimaryKeyConstraint("plant", "version", name=op.f("pk_artifacts")),
    )
    op.create_index(
        op.f("ix_artifacts_plant_digest"), "artifacts", ["plant", "digest"], unique=True
    )
    op.create_table(
        "episodes",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("end_ns", sa.BigInteger(), nullable=False),
        sa.Column("summary", sa.Text(), nullable=False),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_episodes_plant")),
        sa.PrimaryKeyConstraint("plant", "digest", name=op.f("pk_episodes")),
    )
    op.create_index(
        op.f("ix_episodes_plant_role_created_at"),
        "episodes",
        ["plant", "role", "created_at"],
        unique=False,
    )
    op.create_table(
        "gates",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_gates_plant")),
        sa.PrimaryKeyConstraint("plant", "digest", name=op.f("pk_gates")),
    )
    op.create_table(
        "jobs",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("request", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("progress", sa.Float(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("result", sa.Text(), nullable=True),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.Column("updated_at", sa.String(length=27), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_jobs_plant")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_jobs")),
    )
    op.create_index(op.f("ix_jobs_plant_created_at"), "jobs", ["plant", "created_at"], unique=False)
    op.create_table(
        "serving",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("generation", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_serving_plant")),
        sa.PrimaryKeyConstraint("plant", name=op.f("pk_serving")),
    )
    op.create_table(
        "decisions",
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("gate", sa.String(length=64), nullable=False),
        sa.Column("candidate", sa.String(length=64), nullable=False),
        sa.Column("incumbent", sa.String(length=64), nullable=False),
        sa.Column("generation", sa.Integer(), nullable=False),
        sa.Column("accepted", sa.Boolean(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("job", sa.String(length=32), nullable=True),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(
            ["plant", "gate"], ["gates.plant", "gates.digest"], name=op.f("fk_decisions_plant_gate")
        ),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_decisions_plant")),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_decisions")),
    )
    op.create_index(
        op.f("ix_decisions_plant_candidate"), "decisions", ["plant", "candidate"], unique=False
    )
    op.create_index(
        op.f("ix_decisions_plant_created_at"), "decisions", ["plant", "created_at"], unique=False
    )
    op.create_table(
        "job_reads",
        sa.Column("job", sa.String(length=32), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("purpose", sa.String(length=16), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["jobs.id"], name=op.f("fk_job_reads_job")),
        sa.PrimaryKeyConstraint("job", "digest", name=op.f("pk_job_reads")),
    )
    op.create_index(op.f("ix_job_reads_digest"), "job_reads", ["digest"], unique=False)
    op.create_table(
        "moves",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("generation", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("artifact", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("decision", sa.String(length=64), nullable=True),
        sa.Column("back_to", sa.Integer(), nullable=True),
        sa.Column("at", sa.String(length=27), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["decision"], ["decisions.digest"], name=op.f("fk_moves_decision")),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_moves_plant")),
        sa.PrimaryKeyConstraint("plant", "generation", name=op.f("pk_moves")),
    )
    op.create_index(op.f("ix_moves_plant_at"), "moves", ["plant", "at"], unique=False)
    op.bulk_insert(
        sa.table("audit_head", sa.column("id"), sa.column("sequence"), sa.column("digest")),
        [{"id": 1, "sequence": 0, "digest": "0" * 64}],
    )
