"""Continual correction: monitors, what they watched, their alarms, and update policies."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "monitors",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("artifact", sa.String(length=64), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("job", sa.String(length=32), nullable=True),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_monitors_plant_plants")),
        sa.PrimaryKeyConstraint("plant", "digest", name=op.f("pk_monitors")),
    )
    op.create_index(
        op.f("ix_monitors_plant_created_at"), "monitors", ["plant", "created_at"], unique=False
    )
    op.create_table(
        "watching",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("monitor", sa.String(length=64), nullable=False),
        sa.Column("since", sa.String(length=27), nullable=False),
        sa.Column("sequence", sa.Integer(), nullable=False),
        sa.Column("kept", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_watching_plant_plants")),
        sa.PrimaryKeyConstraint("plant", name=op.f("pk_watching")),
    )
    op.create_table(
        "watches",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("monitor", sa.String(length=64), nullable=False),
        sa.Column("sequence", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("episode", sa.String(length=64), nullable=False),
        sa.Column("seen", sa.Text(), nullable=False),
        sa.Column("at", sa.String(length=27), nullable=False),
        sa.ForeignKeyConstraint(
            ["plant", "monitor"],
            ["monitors.plant", "monitors.digest"],
            name=op.f("fk_watches_plant_monitor_monitors"),
        ),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_watches_plant_plants")),
        sa.PrimaryKeyConstraint("plant", "monitor", "sequence", name=op.f("pk_watches")),
    )
    op.create_index(
        op.f("ix_watches_plant_monitor_episode"),
        "watches",
        ["plant", "monitor", "episode"],
        unique=True,
    )
    op.create_table(
        "alarms",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("monitor", sa.String(length=64), nullable=True),
        sa.Column("artifact", sa.String(length=64), nullable=False),
        sa.Column("episode", sa.String(length=64), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("job", sa.String(length=32), nullable=True),
        sa.Column("trial", sa.String(length=32), nullable=True),
        sa.Column("raised_at", sa.String(length=27), nullable=False),
        sa.Column("closed_at", sa.String(length=27), nullable=True),
        sa.Column("closed_by", sa.Text(), nullable=True),
        sa.Column("closed_because", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_alarms_plant_plants")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_alarms")),
    )
    op.create_table(
        "policies",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("sequence", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_policies_plant_plants")),
        sa.PrimaryKeyConstraint("plant", "sequence", name=op.f("pk_policies")),
    )
    op.create_table(
        "evidence",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("artifact", sa.String(length=64), nullable=False),
        sa.Column("stage", sa.String(length=16), nullable=False),
        sa.Column("passed", sa.Boolean(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("job", sa.String(length=32), nullable=True),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_evidence_plant_plants")),
        sa.PrimaryKeyConstraint("plant", "digest", name=op.f("pk_evidence")),
    )
    op.create_index(
        op.f("ix_evidence_plant_artifact"), "evidence", ["plant", "artifact"], unique=False
    )
    op.create_table(
        "channels",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("name", sa.String(length=63), nullable=False),
        sa.Column("requires", sa.Text(), nullable=False),
        sa.Column("created_at", sa.String(length=27), nullable=False),
        sa.Column("created_by", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["plant"], ["plants.name"], name=op.f("fk_channels_plant_plants")),
        sa.PrimaryKeyConstraint("plant", "name", name=op.f("pk_channels")),
    )
    op.create_table(
        "channel_moves",
        sa.Column("plant", sa.String(length=63), nullable=False),
        sa.Column("channel", sa.String(length=63), nullable=False),
        sa.Column("generation", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("artifact", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("evidence", sa.Text(), nullable=False),
        sa.Column("at", sa.String(length=27), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(
            ["plant", "channel"],
            ["channels.plant", "channels.name"],
            name=op.f("fk_channel_moves_plant_channel_channels"),
        ),
        sa.PrimaryKeyConstraint("plant", "channel", "generation", name=op.f("pk_channel_moves")),
    )
    op.create_index(
        op.f("ix_alarms_plant_raised_at"), "alarms", ["plant", "raised_at"], unique=False
    )
