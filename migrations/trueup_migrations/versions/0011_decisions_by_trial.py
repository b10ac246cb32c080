"""Decisions by their trial, and by candidate and outcome: a promotion looks for rejections of its
candidate and for decisions on its episodes, and read every decision to find the latter."""

from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.drop_index(op.f("ix_decisions_plant_candidate"), table_name="decisions")
    op.create_index(
        op.f("ix_decisions_plant_candidate_accepted"),
        "decisions",
        ["plant", "candidate", "accepted"],
    )
    op.create_index(op.f("ix_decisions_job"), "decisions", ["job"])
