"""The tables of the registry. The migrations together make exactly these; a test compares them.

Times are text: UTC, ISO 8601 with microseconds, so that the order of the text is the order of time.
Documents are text too: canonical JSON.
"""

from __future__ import annotations

from collections.abc import Mapping

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
)

NAME, DIGEST, ID, AT = String(63), String(64), String(32), String(27)

DOCUMENT = "document"  # marks a column of JSON text

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
    }
)


def _created() -> tuple[Column[str], Column[str]]:
    """When and by whom a row was made."""
    return Column("created_at", AT, nullable=False), Column("created_by", Text, nullable=False)


def _acted() -> tuple[Column[str], Column[str]]:
    """When something was done, and by whom."""
    return Column("at", AT, nullable=False), Column("actor", Text, nullable=False)


def _plant(*, primary_key: bool = False) -> Column[str]:
    """The plant that a row belongs to."""
    return Column("plant", NAME, ForeignKey("plants.name"), primary_key=primary_key, nullable=False)


def _document(name: str, *, nullable: bool = False) -> Column[str]:
    """A column that holds a document as canonical JSON."""
    return Column(name, Text, nullable=nullable, info={DOCUMENT: True})


projects = Table("projects", metadata, Column("name", NAME, primary_key=True), *_created())

tokens = Table(
    "tokens",
    metadata,
    Column("prefix", String(16), primary_key=True),
    Column("digest", DIGEST, nullable=False),
    Column("name", Text, nullable=False),
    _document("roles"),
    Column("project", NAME, ForeignKey("projects.name")),
    Column("plant", NAME),
    *_created(),
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
    _document("document"),
    *_created(),
    Column("project", NAME),
    Index(None, "project", "name"),
)

episodes = Table(
    "episodes",
    metadata,
    _plant(primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    Column("size_bytes", BigInteger, nullable=False),
    Column("role", String(16), nullable=False),
    Column("start_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    _document("summary"),
    *_created(),
    Column("samples_digest", DIGEST),
    Index(None, "plant", "role", "created_at"),
    Index(None, "samples_digest"),
)

artifacts = Table(
    "artifacts",
    metadata,
    _plant(primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("digest", DIGEST, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("manifest", Text, nullable=False),
    Column("arrays", DIGEST),
    Column("job", ID),
    *_created(),
    Index(None, "plant", "digest", unique=True),
)

gates = Table(
    "gates",
    metadata,
    _plant(primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    _document("document"),
    *_created(),
)

jobs = Table(
    "jobs",
    metadata,
    Column("id", ID, primary_key=True),
    _plant(),
    Column("kind", String(16), nullable=False),
    _document("request"),
    Column("state", String(16), nullable=False),
    Column("progress", Float, nullable=False),
    Column("stage", Text, nullable=False),
    _document("result", nullable=True),
    *_created(),
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
    _plant(),
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
    _plant(),
    Column("gate", DIGEST, nullable=False),
    Column("candidate", DIGEST, nullable=False),
    Column("incumbent", DIGEST, nullable=False),
    Column("generation", Integer, nullable=False),
    Column("accepted", Boolean, nullable=False),
    _document("document"),
    Column("job", ID),
    *_created(),
    ForeignKeyConstraint(["plant", "gate"], ["gates.plant", "gates.digest"]),
    Index(None, "plant", "created_at"),
    Index(None, "plant", "candidate"),
)

serving = Table(
    "serving", metadata, _plant(primary_key=True), Column("generation", Integer, nullable=False)
)

moves = Table(
    "moves",
    metadata,
    _plant(primary_key=True),
    Column("generation", Integer, primary_key=True, autoincrement=False),
    Column("kind", String(16), nullable=False),
    Column("artifact", DIGEST, nullable=False),
    Column("version", Integer, nullable=False),
    Column("decision", DIGEST, ForeignKey("decisions.digest")),
    Column("back_to", Integer),
    *_acted(),
    Index(None, "plant", "at"),
)

approvals = Table(
    "approvals",
    metadata,
    _plant(primary_key=True),
    Column("decision", DIGEST, primary_key=True),
    Column("token", String(16), primary_key=True),
    *_acted(),
    Column("because", Text),
)

imports = Table(
    "imports",
    metadata,
    _plant(primary_key=True),
    Column("archive", DIGEST, nullable=False),
    Column("origin", Text, nullable=False),
    Column("checkpoint", Text, nullable=False),
    Column("entries", DIGEST, nullable=False),
    *_acted(),
)

monitors = Table(
    "monitors",
    metadata,
    _plant(primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    Column("artifact", DIGEST, nullable=False),
    _document("document"),
    Column("job", ID),
    *_created(),
    Index(None, "plant", "created_at"),
)

watching = Table(
    "watching",
    metadata,
    _plant(primary_key=True),
    Column("monitor", DIGEST, nullable=False),
    Column("since", AT, nullable=False),
    Column("sequence", Integer, nullable=False),
    _document("kept"),
)

watches = Table(
    "watches",
    metadata,
    _plant(primary_key=True),
    Column("monitor", DIGEST, primary_key=True),
    Column("sequence", Integer, primary_key=True, autoincrement=False),
    Column("episode", DIGEST, nullable=False),
    _document("seen"),
    Column("at", AT, nullable=False),
    ForeignKeyConstraint(["plant", "monitor"], ["monitors.plant", "monitors.digest"]),
    Index(None, "plant", "monitor", "episode", unique=True),
)

alarms = Table(
    "alarms",
    metadata,
    Column("id", ID, primary_key=True),
    _plant(),
    Column("monitor", DIGEST),
    Column("artifact", DIGEST, nullable=False),
    Column("episode", DIGEST, nullable=False),
    _document("document"),
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
    _plant(primary_key=True),
    Column("sequence", Integer, primary_key=True, autoincrement=False),
    Column("digest", DIGEST, nullable=False),
    _document("document"),
    *_created(),
)

evidence = Table(
    "evidence",
    metadata,
    _plant(primary_key=True),
    Column("digest", DIGEST, primary_key=True),
    Column("artifact", DIGEST, nullable=False),
    Column("stage", String(16), nullable=False),
    Column("passed", Boolean, nullable=False),
    _document("document"),
    Column("job", ID),
    *_created(),
    Index(None, "plant", "artifact"),
)

channels = Table(
    "channels",
    metadata,
    _plant(primary_key=True),
    Column("name", NAME, primary_key=True),
    _document("requires"),
    *_created(),
)

channel_moves = Table(
    "channel_moves",
    metadata,
    Column("plant", NAME, primary_key=True),
    Column("channel", NAME, primary_key=True),
    Column("generation", Integer, primary_key=True, autoincrement=False),
    Column("artifact", DIGEST, nullable=False),
    Column("version", Integer, nullable=False),
    _document("evidence"),
    *_acted(),
    ForeignKeyConstraint(["plant", "channel"], ["channels.plant", "channels.name"]),
)

audit = Table(
    "audit",
    metadata,
    Column("sequence", BigInteger, primary_key=True, autoincrement=False),
    Column("at", AT, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("actor", Text, nullable=False),
    Column("plant", NAME),
    Column("subject", Text, nullable=False),
    _document("facts"),
    _document("rows"),
    Index(None, "plant", "sequence"),
    Index(None, "subject"),
)

audit_tree = Table(
    "audit_tree",
    metadata,
    Column("node", BigInteger, primary_key=True, autoincrement=False),
    Column("hash", LargeBinary(32), nullable=False),
)

audit_head = Table(
    "audit_head",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("size", BigInteger, nullable=False),
    Column("frontier", LargeBinary, nullable=False),
)

audit_key = Table(
    "audit_key",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("verifier", Text, nullable=False),
    Column("endorsement", Text),
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

DOCUMENT_COLUMNS: Mapping[str, frozenset[str]] = {
    table.name: frozenset(c.name for c in table.columns if c.info.get(DOCUMENT))
    for table in metadata.tables.values()
}
