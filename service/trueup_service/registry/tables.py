"""The tables of the registry. The migrations together make exactly these; a test compares them.

Times are text that orders as time does: UTC, ISO 8601 with microseconds. Documents are text too:
canonical JSON."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    String,
    Table,
    Text,
)

from trueup_service.registry.columns import (
    AT,
    DIGEST,
    ID,
    NAME,
    acted,
    created,
    document,
    metadata,
    plant_column,
)
from trueup_service.registry.log_tables import audit, audit_head, audit_key, audit_tree

__all__ = ["audit", "audit_head", "audit_key", "audit_tree", "metadata"]

projects = Table("projects", metadata, Column("name", NAME, primary_key=True), *created())

tokens = Table(
    "tokens",
    metadata,
    Column("prefix", String(16), primary_key=True),
    Column("digest", DIGEST, nullable=False),
    Column("name", Text, nullable=False),
    document("roles"),
    Column("project", NAME, ForeignKey("projects.name")),
    Column("plant", NAME),
    *created(),
    Column("expires_at", AT),
    Column("revoked_at", AT),
    Column("revoked_by", Text),
)

sessions = Table(
    "sessions",
    metadata,
    Column("digest", DIGEST, primary_key=True),
    Column("token", String(16), nullable=False),
    Column("created_at", AT, nullable=False),
    Column("expires_at", AT, nullable=False),
)

plants = Table(
    "plants",
    metadata,
    Column("name", NAME, primary_key=True),
    Column("digest", DIGEST, nullable=False),
    document("document"),
    *created(),
    Column("project", NAME),
    Index(None, "project", "name"),
)

episodes = Table(
    "episodes",
    metadata,
    plant_column(primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    Column("size_bytes", BigInteger, nullable=False),
    Column("role", String(16), nullable=False),
    Column("start_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    document("summary"),
    *created(),
    Column("samples_digest", DIGEST),
    Index(None, "plant", "role", "created_at"),
    Index(None, "plant", "created_at"),
    Index(None, "plant", "start_ns"),
    Index(None, "samples_digest"),
)

labels = Table(
    "labels",
    metadata,
    plant_column(primary_key=True),
    Column("kind", String(16), primary_key=True),
    Column("subject", String(64), primary_key=True),
    Column("name", Text),
    document("tags"),
    Column("note", Text),
    Column("updated_at", AT, nullable=False),
    Column("updated_by", Text, nullable=False),
    Index(None, "kind", "plant"),
)

artifacts = Table(
    "artifacts",
    metadata,
    plant_column(primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("digest", DIGEST, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("manifest", Text, nullable=False),
    Column("arrays", DIGEST),
    Column("job", ID),
    *created(),
    Index(None, "plant", "digest", unique=True),
)

gates = Table(
    "gates",
    metadata,
    plant_column(primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    document("document"),
    *created(),
)

jobs = Table(
    "jobs",
    metadata,
    Column("id", ID, primary_key=True),
    plant_column(),
    Column("kind", String(16), nullable=False),
    document("request"),
    Column("state", String(16), nullable=False),
    Column("progress", Float, nullable=False),
    Column("stage", Text, nullable=False),
    document("result", nullable=True),
    *created(),
    Column("updated_at", AT, nullable=False),
    Index(None, "plant", "created_at"),
    Index(None, "state"),
)

attempts = Table(
    "attempts",
    metadata,
    Column("entry", String(120), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("worker", Text, nullable=False),
    Column("begun_at", AT, nullable=False),
    Column("ended", Text),
    Index(None, "begun_at"),
)

job_reads = Table(
    "job_reads",
    metadata,
    Column("job", ID, ForeignKey("jobs.id"), primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    Column("purpose", String(16), nullable=False),
    Index(None, "digest"),
)

outputs = Table(
    "outputs",
    metadata,
    plant_column(),
    Column("job", ID, ForeignKey("jobs.id"), primary_key=True),
    Column("name", NAME, primary_key=True),
    Column("digest", DIGEST, nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    Column("media_type", String(100), nullable=False),
    Index(None, "digest"),
)

decisions = Table(
    "decisions",
    metadata,
    Column("digest", DIGEST, primary_key=True),
    plant_column(),
    Column("gate", DIGEST, nullable=False),
    Column("candidate", DIGEST, nullable=False),
    Column("incumbent", DIGEST, nullable=False),
    Column("generation", Integer, nullable=False),
    Column("accepted", Boolean, nullable=False),
    document("document"),
    Column("job", ID),
    *created(),
    ForeignKeyConstraint(["plant", "gate"], ["gates.plant", "gates.digest"]),
    Index(None, "plant", "created_at"),
    Index(None, "plant", "candidate", "accepted"),
    Index(None, "job"),
)

serving = Table(
    "serving",
    metadata,
    plant_column(primary_key=True),
    Column("generation", Integer, nullable=False),
)

moves = Table(
    "moves",
    metadata,
    plant_column(primary_key=True),
    Column("generation", Integer, primary_key=True, autoincrement=False),
    Column("kind", String(16), nullable=False),
    Column("artifact", DIGEST, nullable=False),
    Column("version", Integer, nullable=False),
    Column("decision", DIGEST, ForeignKey("decisions.digest")),
    Column("back_to", Integer),
    *acted(),
    Index(None, "plant", "at"),
)

approvals = Table(
    "approvals",
    metadata,
    plant_column(primary_key=True),
    Column("decision", DIGEST, primary_key=True),
    Column("token", String(16), primary_key=True),
    *acted(),
    Column("because", Text),
)

imports = Table(
    "imports",
    metadata,
    plant_column(primary_key=True),
    Column("archive", DIGEST, nullable=False),
    Column("origin", Text, nullable=False),
    Column("checkpoint", Text, nullable=False),
    Column("entries", DIGEST, nullable=False),
    *acted(),
)

monitors = Table(
    "monitors",
    metadata,
    plant_column(primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    Column("artifact", DIGEST, nullable=False),
    document("document"),
    Column("job", ID),
    *created(),
    Index(None, "plant", "created_at"),
)

watching = Table(
    "watching",
    metadata,
    plant_column(primary_key=True),
    Column("monitor", DIGEST, nullable=False),
    Column("since", AT, nullable=False),
    Column("sequence", Integer, nullable=False),
    document("kept"),
)

watches = Table(
    "watches",
    metadata,
    plant_column(primary_key=True),
    Column("monitor", DIGEST, primary_key=True),
    Column("sequence", Integer, primary_key=True, autoincrement=False),
    Column("episode", DIGEST, nullable=False),
    document("seen"),
    Column("at", AT, nullable=False),
    ForeignKeyConstraint(["plant", "monitor"], ["monitors.plant", "monitors.digest"]),
    Index(None, "plant", "monitor", "episode", unique=True),
)

alarms = Table(
    "alarms",
    metadata,
    Column("id", ID, primary_key=True),
    plant_column(),
    Column("monitor", DIGEST),
    Column("artifact", DIGEST, nullable=False),
    Column("episode", DIGEST, nullable=False),
    document("document"),
    Column("job", ID),
    Column("trial", ID),
    Column("raised_at", AT, nullable=False),
    Column("closed_at", AT),
    Column("closed_by", Text),
    Column("closed_because", Text),
    Index(None, "plant", "raised_at"),
)

policies = Table(
    "policies",
    metadata,
    plant_column(primary_key=True),
    Column("sequence", Integer, primary_key=True, autoincrement=False),
    Column("digest", DIGEST, nullable=False),
    document("document"),
    *created(),
)

evidence = Table(
    "evidence",
    metadata,
    plant_column(primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    Column("artifact", DIGEST, nullable=False),
    Column("stage", String(16), nullable=False),
    Column("passed", Boolean, nullable=False),
    document("document"),
    Column("job", ID),
    *created(),
    Index(None, "plant", "artifact"),
)

channels = Table(
    "channels",
    metadata,
    plant_column(primary_key=True),
    Column("name", NAME, primary_key=True),
    document("requires"),
    *created(),
)

channel_moves = Table(
    "channel_moves",
    metadata,
    Column("plant", NAME, primary_key=True),
    Column("channel", NAME, primary_key=True),
    Column("generation", Integer, primary_key=True, autoincrement=False),
    Column("artifact", DIGEST, nullable=False),
    Column("version", Integer, nullable=False),
    document("evidence"),
    *acted(),
    ForeignKeyConstraint(["plant", "channel"], ["channels.plant", "channels.name"]),
)

webhooks = Table(
    "webhooks",
    metadata,
    Column("name", NAME, primary_key=True),
    Column("host", Text, nullable=False),
    Column("target_digest", DIGEST, nullable=False),
    Column("form", String(16), nullable=False),
    document("events"),
    Column("project", NAME),
    Column("plant", NAME),
    *created(),
    Column("removed_at", AT),
    Column("removed_by", Text),
)

webhook_cursors = Table(
    "webhook_cursors",
    metadata,
    Column("webhook", NAME, ForeignKey("webhooks.name"), primary_key=True),
    Column("url", Text, nullable=False),
    Column("secret", Text, nullable=False),
    Column("sent", BigInteger, nullable=False),
    document("sent_beyond"),
    document("held"),
    Column("entry", String(120)),
    Column("attempts", Integer, nullable=False),
    Column("failing_since", AT),
    Column("due_at", AT),
    Column("problem", Text),
    Column("stopped_at", AT),
)

idempotency = Table(
    "idempotency",
    metadata,
    Column("scope", String(160), primary_key=True),
    Column("key", String(255), primary_key=True),
    Column("request_digest", DIGEST, nullable=False),
    Column("response", Text, nullable=False),
    Column("at", AT, nullable=False),
)
