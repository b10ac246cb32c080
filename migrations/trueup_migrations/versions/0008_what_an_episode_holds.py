"""What an episode holds, whatever its bytes are: the same samples in another file are no fresh
test."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("episodes", sa.Column("samples_digest", sa.String(64), nullable=True))
    op.create_index(op.f("ix_episodes_samples_digest"), "episodes", ["samples_digest"])
