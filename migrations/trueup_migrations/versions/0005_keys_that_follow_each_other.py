"""Keys of the log that take over from each other."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("audit_key", sa.Column("endorsement", sa.Text(), nullable=True))
