"""What may be asked of the registry, and what may be added to it.

`Reader` asks, `Writer` adds. Nothing here updates or deletes an episode, an artifact, a gate, a
decision, a move or an audit entry; only a job's progress, the generation that serves, where a
monitor stands, and whether an alarm is open change.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from itertools import accumulate
from typing import Any, TypeVar

from sqlalchemy import (
    BindParameter,
    ColumnElement,
    Connection,
    Select,
    Table,
    bindparam,
    delete,
    func,
    insert,
    literal,
    select,
    text,
    tuple_,
    update,
)
from sqlalchemy.engine import RowMapping

from trueup.canonical import Json, canonical_bytes
from trueup.episode.role import HELD_OUT
from trueup.errors import BrokenChain, PointerMoved
from trueup.ledger.audit import AuditEntry, entry_bytes
from trueup.ledger.merkle import Frontier, Node, leaf_hash, node_of, number_of
from trueup.ledger.rows import KEYS, row_digest, row_name
from trueup_service.registry import tables as t
from trueup_service.registry.database import Database
from trueup_service.registry.records import (
    FINAL,
    NOTHING_CAME,
    AlarmRecord,
    Approval,
    ArtifactRecord,
    AuditKey,
    ChannelMove,
    ChannelRecord,
    DecisionRecord,
    EpisodeRecord,
    EvidenceRecord,
    GateRecord,
    ImportRecord,
    JobRecord,
    JobState,
    MonitorRecord,
    Move,
    OutputRecord,
    PlantRecord,
    PolicyRecord,
    ProjectRecord,
    TokenRecord,
    Watch,
    Watching,
)
from trueup_service.registry.rows import plain, stored

R = TypeVar("R")
_JSON = {
    "document",
    "summary",
    "request",
    "result",
    "facts",
    "kept",
    "seen",
    "requires",
    "evidence",
    "rows",
    "roles",
}

AT_ONCE = 500  # digests that one statement names

# Statements of the busiest paths, built once: building one costs about as much as running it.
_BY_PLANT: BindParameter[str] = bindparam("plant")
_PLANT = select(t.plants).where(t.plants.c.name == _BY_PLANT)
_PLANT_DIGEST = select(t.plants.c.digest).where(t.plants.c.name == _BY_PLANT)
_LOCK_PLANT = select(t.plants.c.name).where(t.plants.c.name == _BY_PLANT).with_for_update()
_ARTIFACT = select(t.artifacts).where(
    t.artifacts.c.plant == _BY_PLANT, t.artifacts.c.digest == bindparam("digest")
)
_LATEST_VERSION = select(func.max(t.artifacts.c.version)).where(t.artifacts.c.plant == _BY_PLANT)
_SERVING = (
    select(t.moves)
    .join(
        t.serving,
        (t.moves.c.plant == t.serving.c.plant) & (t.moves.c.generation == t.serving.c.generation),
    )
    .where(t.serving.c.plant == _BY_PLANT)
)
_DECISION = select(t.decisions).where(t.decisions.c.digest == bindparam("digest"))
_SWAP = (
    update(t.serving)
    .where(t.serving.c.plant == bindparam("of"), t.serving.c.generation == bindparam("before"))
    .values(generation=bindparam("after"))
)
_LOCK_NAME = text("SELECT pg_advisory_xact_lock(hashtextextended(:name, 0))")
_HEAD = select(t.audit_head.c.size, t.audit_head.c.frontier).where(t.audit_head.c.id == 1)
_SIZE = select(t.audit_head.c.size).where(t.audit_head.c.id == 1).scalar_subquery()
_LOCK_HEAD = _HEAD.with_for_update()
_MOVE_HEAD = update(t.audit_head).values(
    size=bindparam("new_size"), frontier=bindparam("new_frontier")
)
_NODES = select(t.audit_tree).where(t.audit_tree.c.node.in_(bindparam("nodes", expanding=True)))
_FORGET_ANSWER = delete(t.idempotency).where(
    t.idempotency.c.scope == bindparam("of"),
    t.idempotency.c.key == bindparam("under"),
    t.idempotency.c.at == bindparam("since"),
)
_INSERT = {name: insert(table) for name, table in t.metadata.tables.items()}


class Reader:
    """Questions, inside one transaction."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def plant(self, name: str) -> PlantRecord | None:
        return self._one(PlantRecord, _PLANT, plant=name)

    def plant_digest(self, name: str) -> str | None:
        """The digest of a plant's description, without the description."""
        found: str | None = self.connection.scalar(_PLANT_DIGEST, {"plant": name})
        return found

    def plants(self, after: str, limit: int, project: str | None = None) -> list[PlantRecord]:
        """Plants by name, of one project or of all."""
        query = select(t.plants).where(t.plants.c.name > after)
        query = query if project is None else query.where(t.plants.c.project == project)
        return self._all(PlantRecord, query.order_by(t.plants.c.name).limit(limit))

    def belongs(self, plant: str, project: str) -> bool:
        """Whether a plant is there and of this project."""
        found = self.connection.scalar(select(t.plants.c.project).where(t.plants.c.name == plant))
        return bool(found == project)

    def project(self, name: str) -> ProjectRecord | None:
        return self._one(ProjectRecord, select(t.projects).where(t.projects.c.name == name))

    def projects(self, after: str, limit: int) -> list[ProjectRecord]:
        query = select(t.projects).where(t.projects.c.name > after).order_by(t.projects.c.name)
        return self._all(ProjectRecord, query.limit(limit))

    def token(self, prefix: str) -> TokenRecord | None:
        return self._one(TokenRecord, select(t.tokens).where(t.tokens.c.prefix == prefix))

    def tokens(self, after: str, limit: int) -> list[TokenRecord]:
        query = select(t.tokens).where(t.tokens.c.prefix > after).order_by(t.tokens.c.prefix)
        return self._all(TokenRecord, query.limit(limit))

    def session(self, digest: str, now: str) -> str | None:
        """The token of a session that has not ended."""
        query = select(t.sessions.c.token).where(
            t.sessions.c.digest == digest, t.sessions.c.expires_at > now
        )
        found: str | None = self.connection.scalar(query)
        return found

    def approvals(self, plant: str, decision: str) -> list[Approval]:
        """Who wants a decision promoted, in order."""
        of = t.approvals.c.plant == plant, t.approvals.c.decision == decision
        return self._all(
            Approval, select(t.approvals).where(*of).order_by(t.approvals.c.at, t.approvals.c.token)
        )

    def episode(self, plant: str, digest: str) -> EpisodeRecord | None:
        return self._one(
            EpisodeRecord,
            select(t.episodes).where(t.episodes.c.plant == plant, t.episodes.c.digest == digest),
        )

    def episodes(self, plant: str, role: str | None, after: str, limit: int) -> list[EpisodeRecord]:
        """Episodes in the order of their digests, from behind `after`."""
        query = select(t.episodes).where(t.episodes.c.plant == plant, t.episodes.c.digest > after)
        query = query if role is None else query.where(t.episodes.c.role == role)
        return self._all(EpisodeRecord, query.order_by(t.episodes.c.digest).limit(limit))

    def episodes_of_role(
        self, plant: str, roles: Iterable[str], since_ns: int | None = None, came_in: str = ""
    ) -> list[EpisodeRecord]:
        """Every episode of these roles that was recorded `since_ns` and came in after a time, in
        the order of their start."""
        query = select(t.episodes).where(
            t.episodes.c.plant == plant,
            t.episodes.c.role.in_(list(roles)),
            t.episodes.c.created_at > came_in,
        )
        query = query if since_ns is None else query.where(t.episodes.c.start_ns >= since_ns)
        return self._all(EpisodeRecord, query.order_by(t.episodes.c.start_ns, t.episodes.c.digest))

    def samples_of_role(self, plant: str, role: str) -> set[str]:
        """The digests of the samples of every episode of a role that tells them."""
        of = t.episodes.c
        held = select(of.samples_digest).where(
            of.plant == plant, of.role == role, of.samples_digest.is_not(None)
        )
        return set(self.connection.scalars(held))

    def artifact(self, plant: str, digest: str) -> ArtifactRecord | None:
        return self._one(ArtifactRecord, _ARTIFACT, plant=plant, digest=digest)

    def artifact_version(self, plant: str, version: int) -> ArtifactRecord | None:
        return self._one(
            ArtifactRecord,
            select(t.artifacts).where(
                t.artifacts.c.plant == plant, t.artifacts.c.version == version
            ),
        )

    def artifacts(self, plant: str, after: int, limit: int) -> list[ArtifactRecord]:
        return self._all(
            ArtifactRecord,
            select(t.artifacts)
            .where(t.artifacts.c.plant == plant, t.artifacts.c.version > after)
            .order_by(t.artifacts.c.version)
            .limit(limit),
        )

    def latest_version(self, plant: str) -> int:
        """The highest version of a plant, 0 for none."""
        return int(self.connection.scalar(_LATEST_VERSION, {"plant": plant}) or 0)

    def gate(self, plant: str, digest: str) -> GateRecord | None:
        return self._one(
            GateRecord, select(t.gates).where(t.gates.c.plant == plant, t.gates.c.digest == digest)
        )

    def gates(self, plant: str, after: str, limit: int) -> list[GateRecord]:
        return self._all(
            GateRecord,
            select(t.gates)
            .where(t.gates.c.plant == plant, t.gates.c.digest > after)
            .order_by(t.gates.c.digest)
            .limit(limit),
        )

    def gate_line(self, plant: str) -> list[GateRecord]:
        """Every gate of a plant in the order in which the log tells of them; those that came from
        elsewhere first, by their time."""
        found = self._all(GateRecord, select(t.gates).where(t.gates.c.plant == plant))
        at = self.log_positions(plant, "gate:declared", [g.digest for g in found])
        return sorted(found, key=lambda g: (at.get(g.digest, 0), g.created_at, g.digest))

    def log_positions(self, plant: str, kind: str, subjects: Sequence[str]) -> dict[str, int]:
        """The first entry of a kind on each of these subjects of a plant; none on what came from
        elsewhere."""
        query = (
            select(t.audit.c.subject, func.min(t.audit.c.sequence))
            .where(
                t.audit.c.plant == plant,
                t.audit.c.kind == kind,
                t.audit.c.subject.in_(bindparam("subjects", expanding=True)),
            )
            .group_by(t.audit.c.subject)
        )
        return {
            str(subject): int(sequence)
            for subject, sequence in self._in_parts(query, "subjects", subjects)
        }

    def job(self, job: str) -> JobRecord | None:
        return self._one(JobRecord, select(t.jobs).where(t.jobs.c.id == job))

    def jobs(self, plant: str, before: str, limit: int) -> list[JobRecord]:
        """Jobs, the newest first, created before a time."""
        return self._all(
            JobRecord,
            select(t.jobs)
            .where(t.jobs.c.plant == plant, t.jobs.c.created_at < before)
            .order_by(t.jobs.c.created_at.desc(), t.jobs.c.id)
            .limit(limit),
        )

    def jobs_under_way(self) -> list[str]:
        """Every job that has not ended."""
        return list(
            self.connection.scalars(
                select(t.jobs.c.id)
                .where(t.jobs.c.state.not_in(FINAL))
                .order_by(t.jobs.c.created_at)
            )
        )

    def job_reads(self, job: str) -> dict[str, str]:
        """Digest of everything a job has read, and what for."""
        rows = self.connection.execute(
            select(t.job_reads.c.digest, t.job_reads.c.purpose)
            .where(t.job_reads.c.job == job)
            .order_by(t.job_reads.c.digest)
        )
        return {row.digest: row.purpose for row in rows}

    def outputs(self, job: str) -> list[OutputRecord]:
        """Files that a job left behind, by name."""
        return self._all(
            OutputRecord, select(t.outputs).where(t.outputs.c.job == job).order_by(t.outputs.c.name)
        )

    def output(self, job: str, name: str) -> OutputRecord | None:
        return self._one(
            OutputRecord, select(t.outputs).where(t.outputs.c.job == job, t.outputs.c.name == name)
        )

    def held_out(self, plant: str) -> int:
        """How many held-out episodes a plant has."""
        query = (
            select(func.count())
            .select_from(t.episodes)
            .where(t.episodes.c.plant == plant, t.episodes.c.role.in_(HELD_OUT))
        )
        return int(self.connection.scalar(query) or 0)

    def uses(self, digest: str, purpose: str) -> int:
        """How many jobs have read what these bytes hold for this purpose, of whichever plant; those
        that came to nothing do not count."""
        query = (
            select(func.count())
            .select_from(t.job_reads.join(t.jobs, t.jobs.c.id == t.job_reads.c.job))
            .where(
                (t.job_reads.c.digest == digest) | t.job_reads.c.digest.in_(_twins(digest)),
                t.job_reads.c.purpose == purpose,
                t.jobs.c.state.not_in(NOTHING_CAME),
            )
        )
        return int(self.connection.scalar(query) or 0)

    def twins(self, digest: str, plant: str | None = None) -> set[str]:
        """The digests of the episodes that hold the samples of this one, of any plant or of one;
        itself among them."""
        query = _twins(digest)
        query = query if plant is None else query.where(t.episodes.c.plant == plant)
        return {digest, *self.connection.scalars(query)}

    def jobs_reading(self, digests: Sequence[str], purpose: str) -> list[JobRecord]:
        """Every job that read any of these bytes for a purpose, in the order in which they were
        asked for."""
        reads = select(t.job_reads.c.job).where(
            t.job_reads.c.purpose == purpose,
            t.job_reads.c.digest.in_(bindparam("digests", expanding=True)),
        )
        query = (
            select(t.jobs).where(t.jobs.c.id.in_(reads)).order_by(t.jobs.c.created_at, t.jobs.c.id)
        )
        found = {
            row.id: record_of(JobRecord, row._mapping)
            for row in self._in_parts(query, "digests", digests)
        }
        return list(found.values())

    def decision(self, digest: str) -> DecisionRecord | None:
        return self._one(DecisionRecord, _DECISION, digest=digest)

    def decisions(self, plant: str, before: str, limit: int) -> list[DecisionRecord]:
        """Decisions, the newest first, made before a time."""
        query = select(t.decisions).where(
            t.decisions.c.plant == plant, t.decisions.c.created_at < before
        )
        return self._all(
            DecisionRecord,
            query.order_by(t.decisions.c.created_at.desc(), t.decisions.c.digest).limit(limit),
        )

    def decisions_on(
        self, plant: str, candidate: str, episodes: Sequence[str]
    ) -> list[DecisionRecord]:
        """Decisions on a candidate, and those of the plant's whole project on any of these
        episodes, in the order of their making."""
        project = self.connection.scalar(select(t.plants.c.project).where(t.plants.c.name == plant))
        near = select(t.plants.c.name).where(
            t.plants.c.project.is_(None) if project is None else t.plants.c.project == project
        )
        return self._decisions([candidate], plant, episodes, t.decisions.c.plant.in_(near))

    def rejections_of(
        self, plant: str, candidates: Sequence[str], episodes: Sequence[str]
    ) -> list[DecisionRecord]:
        """Rejections of some candidates, and those of all plants, whichever their project, on any
        of these episodes, in order."""
        return self._decisions(candidates, plant, episodes, t.decisions.c.accepted.is_(False))

    def _decisions(
        self, candidates: Sequence[str], plant: str, episodes: Sequence[str], *which: Any
    ) -> list[DecisionRecord]:
        reads = select(t.job_reads.c.job).where(
            t.job_reads.c.purpose == "gate",
            t.job_reads.c.digest.in_(bindparam("digests", expanding=True)),
        )
        on_them = select(t.decisions).where(t.decisions.c.job.in_(reads), *which)
        own = select(t.decisions).where(
            t.decisions.c.plant == plant, t.decisions.c.candidate.in_(candidates), *which
        )
        found = self._all(DecisionRecord, own)
        found += [
            record_of(DecisionRecord, row._mapping)
            for row in self._in_parts(on_them, "digests", episodes)
        ]
        return sorted({d.digest: d for d in found}.values(), key=lambda d: (d.created_at, d.digest))

    def not_accepted(self, plant: str, besides: str, most: int) -> list[str]:
        """Candidates of a plant, except for one, that wait for their verdict or were rejected: so
        many, those first and then the newest."""
        of, candidate = t.decisions.c, t.decisions.c.candidate
        refused = (
            select(candidate).where(of.plant == plant, of.accepted.is_(False)).group_by(candidate)
        )
        query = select(t.jobs).where(
            t.jobs.c.plant == plant, t.jobs.c.kind == "gate", t.jobs.c.state.not_in(FINAL)
        )
        waiting = [
            str(job.request["candidate"])
            for job in self._all(JobRecord, query.order_by(t.jobs.c.created_at.desc(), t.jobs.c.id))
        ]
        newest = self.connection.scalars(
            refused.order_by(func.max(of.created_at).desc(), candidate).limit(most + 1)
        )
        return [c for c in dict.fromkeys([*waiting, *newest]) if c != besides][:most]

    def is_judging(self, plant: str) -> bool:
        """Whether a trial of the plant is under way or came to something."""
        query = select(t.jobs.c.id).where(
            t.jobs.c.plant == plant, t.jobs.c.kind == "gate", t.jobs.c.state.not_in(NOTHING_CAME)
        )
        return self.connection.scalar(query.limit(1)) is not None

    def decisions_naming(self, plant: str, digest: str) -> list[str]:
        """Decisions that name an artifact as candidate or incumbent."""
        query = select(t.decisions.c.digest).where(
            t.decisions.c.plant == plant,
            (t.decisions.c.candidate == digest) | (t.decisions.c.incumbent == digest),
        )
        return list(self.connection.scalars(query))

    def serving(self, plant: str) -> Move | None:
        """What serves now."""
        return self._one(Move, _SERVING, plant=plant)

    def move(self, plant: str, generation: int) -> Move | None:
        return self._one(
            Move,
            select(t.moves).where(t.moves.c.plant == plant, t.moves.c.generation == generation),
        )

    def moves(self, plant: str, after: int, limit: int) -> list[Move]:
        return self._all(
            Move,
            select(t.moves)
            .where(t.moves.c.plant == plant, t.moves.c.generation > after)
            .order_by(t.moves.c.generation)
            .limit(limit),
        )

    def served_at(self, plant: str, at: str) -> Move | None:
        """What was serving at a time."""
        return self._one(
            Move,
            select(t.moves)
            .where(t.moves.c.plant == plant, t.moves.c.at <= at)
            .order_by(t.moves.c.generation.desc())
            .limit(1),
        )

    def monitor(self, plant: str, digest: str) -> MonitorRecord | None:
        return self._one(
            MonitorRecord,
            select(t.monitors).where(t.monitors.c.plant == plant, t.monitors.c.digest == digest),
        )

    def monitors(self, plant: str, before: str, limit: int) -> list[MonitorRecord]:
        """Monitors, the newest first, made before a time."""
        query = select(t.monitors).where(
            t.monitors.c.plant == plant, t.monitors.c.created_at < before
        )
        return self._all(
            MonitorRecord,
            query.order_by(t.monitors.c.created_at.desc(), t.monitors.c.digest).limit(limit),
        )

    def policy(self, plant: str) -> PolicyRecord | None:
        """The policy that holds."""
        query = (
            select(t.policies)
            .where(t.policies.c.plant == plant)
            .order_by(t.policies.c.sequence.desc())
            .limit(1)
        )
        return self._one(PolicyRecord, query)

    def policies(self, plant: str, after: int, limit: int) -> list[PolicyRecord]:
        """Every policy there was, in order."""
        query = select(t.policies).where(t.policies.c.plant == plant, t.policies.c.sequence > after)
        return self._all(PolicyRecord, query.order_by(t.policies.c.sequence).limit(limit))

    def policies_that_hold(self) -> list[PolicyRecord]:
        """The policy of every plant that has one."""
        last = (
            select(t.policies.c.plant, func.max(t.policies.c.sequence).label("sequence"))
            .group_by(t.policies.c.plant)
            .subquery()
        )
        query = select(t.policies).join(
            last, (t.policies.c.plant == last.c.plant) & (t.policies.c.sequence == last.c.sequence)
        )
        return self._all(PolicyRecord, query.order_by(t.policies.c.plant))

    def evidence(self, plant: str, digest: str) -> EvidenceRecord | None:
        return self._one(
            EvidenceRecord,
            select(t.evidence).where(t.evidence.c.plant == plant, t.evidence.c.digest == digest),
        )

    def last_evidence(self, plant: str, artifact: str) -> dict[str, tuple[str, bool]]:
        """Of each stage that an artifact was at, the digest of what was found last, and whether it
        was passed."""
        e = t.evidence.c
        query = (
            select(e.stage, e.digest, e.passed)
            .where(e.plant == plant, e.artifact == artifact)
            .order_by(e.created_at, e.digest)
        )
        return {row.stage: (row.digest, row.passed) for row in self.connection.execute(query)}

    def evidence_of(
        self, plant: str, artifact: str, after: tuple[str, str], limit: int, limit_bytes: int
    ) -> tuple[list[EvidenceRecord], bool]:
        """What was found of an artifact, in order of time and digest, from behind `after`, and
        whether there is more.

        At most `limit` of them, and the first one and as many more as have `limit_bytes` of
        documents together.
        """
        key, of = (
            tuple_(t.evidence.c.created_at, t.evidence.c.digest),
            (t.evidence.c.plant == plant, t.evidence.c.artifact == artifact),
        )
        sizes = select(
            t.evidence.c.created_at, t.evidence.c.digest, func.length(t.evidence.c.document)
        ).where(*of, key > after)
        found = self.connection.execute(sizes.order_by(*key.clauses).limit(limit + 1)).all()
        together = accumulate(size for *_, size in found)
        shown = found[: max(1, min(limit, sum(size <= limit_bytes for size in together)))]
        if not shown:
            return [], False
        last = tuple(shown[-1][:2])
        query = select(t.evidence).where(*of, key > after, key <= last).order_by(*key.clauses)
        return self._all(EvidenceRecord, query), len(shown) < len(found)

    def channel(self, plant: str, name: str) -> ChannelRecord | None:
        return self._one(
            ChannelRecord,
            select(t.channels).where(t.channels.c.plant == plant, t.channels.c.name == name),
        )

    def channels(self, plant: str, after: str, limit: int) -> list[ChannelRecord]:
        query = select(t.channels).where(t.channels.c.plant == plant, t.channels.c.name > after)
        return self._all(ChannelRecord, query.order_by(t.channels.c.name).limit(limit))

    def channel_move(self, plant: str, channel: str) -> ChannelMove | None:
        """Where a channel stands, None if it never served."""
        query = select(t.channel_moves).where(
            t.channel_moves.c.plant == plant, t.channel_moves.c.channel == channel
        )
        return self._one(ChannelMove, query.order_by(t.channel_moves.c.generation.desc()).limit(1))

    def has_served(self, plant: str, artifact: str) -> bool:
        """Whether the plant's own pointer ever stood at an artifact."""
        query = select(t.moves.c.generation).where(
            t.moves.c.plant == plant, t.moves.c.artifact == artifact
        )
        return self.connection.scalar(query.limit(1)) is not None

    def last_job(self, plant: str, kind: str) -> JobRecord | None:
        """The newest job of a kind."""
        query = select(t.jobs).where(t.jobs.c.plant == plant, t.jobs.c.kind == kind)
        return self._one(JobRecord, query.order_by(t.jobs.c.created_at.desc()).limit(1))

    def watching(self, plant: str) -> Watching | None:
        """Which monitor watches a plant, and where it stands."""
        return self._one(Watching, select(t.watching).where(t.watching.c.plant == plant))

    def watches(self, plant: str, monitor: str, after: int, limit: int) -> list[Watch]:
        """What a monitor saw, episode by episode, from behind a sequence number."""
        query = select(t.watches).where(
            t.watches.c.plant == plant, t.watches.c.monitor == monitor, t.watches.c.sequence > after
        )
        return self._all(Watch, query.order_by(t.watches.c.sequence).limit(limit))

    def last_watch(self, plant: str, monitor: str) -> int:
        """How many episodes a monitor has seen, also in an earlier time of watching."""
        query = select(func.max(t.watches.c.sequence)).where(
            t.watches.c.plant == plant, t.watches.c.monitor == monitor
        )
        return int(self.connection.scalar(query) or 0)

    def unwatched(self, of: Watching, roles: Iterable[str], limit: int) -> list[EpisodeRecord]:
        """Episodes that came in since a monitor watches and that it has not seen, in the order of
        their start."""
        seen = select(t.watches.c.episode).where(
            t.watches.c.plant == of.plant,
            t.watches.c.monitor == of.monitor,
            t.watches.c.episode == t.episodes.c.digest,
        )
        query = select(t.episodes).where(
            t.episodes.c.plant == of.plant, t.episodes.c.role.in_(list(roles))
        )
        query = query.where(t.episodes.c.created_at >= of.since, ~seen.exists())
        return self._all(
            EpisodeRecord, query.order_by(t.episodes.c.start_ns, t.episodes.c.digest).limit(limit)
        )

    def waits(self, plant: str, kind: str) -> bool:
        """Whether a job of this kind has not begun yet."""
        query = select(t.jobs.c.id).where(
            t.jobs.c.plant == plant, t.jobs.c.kind == kind, t.jobs.c.state == JobState.QUEUED
        )
        return self.connection.scalar(query.limit(1)) is not None

    def alarm(self, alarm: str) -> AlarmRecord | None:
        return self._one(AlarmRecord, select(t.alarms).where(t.alarms.c.id == alarm))

    def alarms(self, plant: str, before: str, limit: int) -> list[AlarmRecord]:
        """Alarms, the newest first, raised before a time."""
        query = select(t.alarms).where(t.alarms.c.plant == plant, t.alarms.c.raised_at < before)
        return self._all(
            AlarmRecord, query.order_by(t.alarms.c.raised_at.desc(), t.alarms.c.id).limit(limit)
        )

    def open_alarm(self, plant: str) -> AlarmRecord | None:
        """The alarm that nobody has closed yet."""
        query = select(t.alarms).where(t.alarms.c.plant == plant, t.alarms.c.closed_at.is_(None))
        return self._one(AlarmRecord, query.order_by(t.alarms.c.raised_at).limit(1))

    def audit_entries(
        self, after: int, limit: int, plant: str | None = None, project: str | None = None
    ) -> list[AuditEntry]:
        """Entries in order, all of them, or those of a plant or of a project's plants."""
        query = select(t.audit).where(t.audit.c.sequence > after, t.audit.c.sequence <= _SIZE)
        of_project = select(t.plants.c.name).where(t.plants.c.project == project)
        query = query if project is None else query.where(t.audit.c.plant.in_(of_project))
        query = query if plant is None else query.where(t.audit.c.plant == plant)
        return self._all(AuditEntry, query.order_by(t.audit.c.sequence).limit(limit))

    def audit_tree(self) -> Frontier:
        """The log's tree as it stands."""
        row = self.connection.execute(_HEAD).first()
        if row is None:
            raise BrokenChain("the log has no head")
        return Frontier.from_bytes(row.size, row.frontier)

    def audit_beyond(self) -> int:
        """How many entries are kept behind the end of the log, where none can be."""
        return int(
            self.connection.scalar(
                select(func.count()).select_from(t.audit).where(t.audit.c.sequence > _SIZE)
            )
            or 0
        )

    def audit_nodes(self, nodes: Iterable[Node]) -> dict[Node, bytes]:
        """The hashes of these perfect subtrees of the log's tree; those that there are not yet are
        left out."""
        found = self.connection.execute(_NODES, {"nodes": [number_of(node) for node in set(nodes)]})
        return {node_of(row.node): bytes(row.hash) for row in found}

    def audit_tile(self, level: int, first: int, count: int) -> list[bytes]:
        """Neighbouring subtrees of one level, in order; fewer where the tree ends."""
        at, begin = t.audit_tree.c.node, number_of((level, first))
        query = select(t.audit_tree.c.hash).where(at >= begin, at < begin + count).order_by(at)
        return [bytes(found) for found in self.connection.scalars(query)]

    def audit_keys(self) -> list[AuditKey]:
        """The public keys under which the log was signed, the one that signs now last."""
        query = select(t.audit_key.c.verifier, t.audit_key.c.endorsement).order_by(t.audit_key.c.id)
        return [AuditKey(*row) for row in self.connection.execute(query)]

    def rows(
        self, table: Table, after: Sequence[Any], limit: int, plant: str | None = None
    ) -> list[dict[str, Any]]:
        """Rows as they are stored, in the order of their keys, from behind one; of all plants or of
        one."""
        key = tuple(table.primary_key.columns)
        query = select(table).order_by(*key).limit(limit)
        query = (
            query
            if plant is None
            else query.where((table.c.name if table is t.plants else table.c.plant) == plant)
        )
        query = (
            query.where(
                tuple_(*key)
                > tuple_(*(literal(v, c.type) for v, c in zip(after, key, strict=True)))
            )
            if after
            else query
        )
        return [plain(table, row) for row in self.connection.execute(query).mappings()]

    def names(self, digest: str) -> bool:
        """Whether a row names these bytes."""
        named = (t.episodes.c.digest, t.artifacts.c.arrays, t.imports.c.entries, t.outputs.c.digest)
        return any(
            self.connection.scalar(select(column).where(column == digest).limit(1)) is not None
            for column in named
        )

    def remembered(self, scope: str, key: str) -> tuple[str, dict[str, Json]] | None:
        """The request digest and the response kept under an idempotency key."""
        row = self.connection.execute(
            select(t.idempotency.c.request_digest, t.idempotency.c.response).where(
                t.idempotency.c.scope == scope, t.idempotency.c.key == key
            )
        ).first()
        return (row.request_digest, json.loads(row.response)) if row else None

    def answers_beyond(self, before: str, kept: int) -> list[tuple[str, str, str]]:
        """Answers under idempotency keys given before a time, and of each token all but the newest
        ones: scope, key and time."""
        c, counted, found = t.idempotency.c, Counter[str](), []
        answers = select(c.scope, c.key, c.at).order_by(c.at.desc(), c.scope, c.key)
        if (self.connection.scalar(select(func.count()).select_from(t.idempotency)) or 0) <= kept:
            answers = answers.where(c.at < before)  # no token can have more
        for scope, key, at in self.connection.execute(answers):
            token = scope.rpartition("@")[2]
            counted[token] += 1
            if at < before or counted[token] > kept:
                found.append((scope, key, at))
        return found

    def _in_parts(self, query: Select[Any], name: str, values: Sequence[str]) -> Iterator[Any]:
        """The rows of a query whose parameter `name` takes a list, for as many values as there
        are."""
        for begin in range(0, len(values), AT_ONCE):
            yield from self.connection.execute(query, {name: list(values[begin : begin + AT_ONCE])})

    def _one(self, kind: type[R], query: Select[Any], **values: Any) -> R | None:
        row = self.connection.execute(query, values).mappings().first()
        return None if row is None else record_of(kind, row)

    def _all(self, kind: type[R], query: Select[Any]) -> list[R]:
        return [record_of(kind, row) for row in self.connection.execute(query).mappings()]


class Writer(Reader):
    """Additions, inside one transaction. `append_audit` comes last: it queues behind every other
    writer until the commit.

    Every row that is written is named in the next entry of the log, by digest.
    """

    def __init__(self, connection: Connection) -> None:
        super().__init__(connection)
        self.written: dict[
            str, str
        ] = {}  # since the last entry: what a row is called, and its digest

    def add_plant(self, record: PlantRecord) -> None:
        self._add(t.plants, asdict(record))

    def add_project(self, record: ProjectRecord) -> None:
        self._add(t.projects, asdict(record))

    def add_token(self, record: TokenRecord) -> None:
        self._add(t.tokens, asdict(record))

    def revoke_token(self, prefix: str, now: str, actor: str) -> bool:
        """Revoke a token; False if it is revoked already."""
        where = t.tokens.c.prefix == prefix, t.tokens.c.revoked_at.is_(None)
        changed = self.connection.execute(
            update(t.tokens).where(*where).values(revoked_at=now, revoked_by=actor)
        )
        if changed.rowcount == 1:
            self._wrote(t.tokens, t.tokens.c.prefix == prefix)
        return changed.rowcount == 1

    def add_session(self, digest: str, token: str, now: str, expires_at: str) -> None:
        """Begin a session, and forget those that have ended."""
        self.connection.execute(delete(t.sessions).where(t.sessions.c.expires_at <= now))
        self._add(
            t.sessions,
            {"digest": digest, "token": token, "created_at": now, "expires_at": expires_at},
        )

    def end_session(self, digest: str) -> None:
        self.connection.execute(delete(t.sessions).where(t.sessions.c.digest == digest))

    def add_approval(self, record: Approval) -> None:
        self._add(t.approvals, asdict(record))

    def add_episode(self, record: EpisodeRecord) -> None:
        self._add(t.episodes, asdict(record))

    def add_artifact(self, record: ArtifactRecord) -> None:
        self._add(t.artifacts, asdict(record))

    def add_gate(self, record: GateRecord) -> None:
        self._add(t.gates, asdict(record))

    def add_decision(self, record: DecisionRecord) -> None:
        self._add(t.decisions, asdict(record))

    def add_job(self, record: JobRecord) -> None:
        self._add(t.jobs, asdict(record))

    def add_output(self, record: OutputRecord) -> None:
        self._add(t.outputs, asdict(record))

    def add_reads(self, job: str, digests: Sequence[str], purpose: str) -> None:
        """Note what a job reads; noting it again changes nothing."""
        known = self.job_reads(job)
        for digest in digests:
            if digest not in known:
                self._add(t.job_reads, {"job": job, "digest": digest, "purpose": purpose})

    def lock_plant(self, plant: str) -> None:
        """Hold every other writer of this plant until the commit."""
        if (
            self.connection.dialect.name != "sqlite"
        ):  # there every writer holds all others from its beginning
            self.connection.execute(_LOCK_PLANT, {"plant": plant})

    def lock_name(self, name: str) -> None:
        """Hold every other writer that locks this name until the commit, though there is no row of
        it yet."""
        if self.connection.dialect.name != "sqlite":
            self.connection.execute(_LOCK_NAME, {"name": name})

    def update_job(
        self,
        job: str,
        *,
        now: str,
        state: JobState | None = None,
        progress: float | None = None,
        stage: str | None = None,
        result: dict[str, Json] | None = None,
        only_from: str | None = None,
    ) -> bool:
        """Move a job on; False if it is in a final state, which never changes, or not in the state
        that it is to leave."""
        given = {
            "state": state and str(state),
            "progress": progress,
            "stage": stage,
            "result": None if result is None else _text(result),
        }
        values = {key: value for key, value in given.items() if value is not None} | {
            "updated_at": now
        }
        where = t.jobs.c.state.not_in(FINAL) if only_from is None else t.jobs.c.state == only_from
        changed = self.connection.execute(
            update(t.jobs).where(t.jobs.c.id == job, where).values(values)
        )
        if state in FINAL and changed.rowcount == 1:
            self._wrote(t.jobs, t.jobs.c.id == job)
        return changed.rowcount == 1

    def begin_serving(self, move: Move) -> None:
        """The first position of a plant's pointer."""
        self._add(t.moves, asdict(move))
        self._add(t.serving, {"plant": move.plant, "generation": move.generation})

    def move_serving(self, move: Move) -> None:
        """Compare and swap: the pointer goes to `move` if it stands one generation before. Raises
        PointerMoved."""
        swapped = self.connection.execute(
            _SWAP, {"of": move.plant, "before": move.generation - 1, "after": move.generation}
        )
        if swapped.rowcount != 1:
            raise PointerMoved(
                f"another move took generation {move.generation}", expected=move.generation - 1
            )
        self._note(t.serving, {"plant": move.plant, "generation": move.generation})
        self._add(t.moves, asdict(move))

    def add_monitor(self, record: MonitorRecord) -> None:
        self._add(t.monitors, asdict(record))

    def add_evidence(self, record: EvidenceRecord) -> None:
        self._add(t.evidence, asdict(record))

    def add_channel(self, record: ChannelRecord) -> None:
        self._add(t.channels, asdict(record))

    def move_channel(self, move: ChannelMove) -> None:
        self._add(t.channel_moves, asdict(move))

    def add_policy(self, record: PolicyRecord) -> None:
        self._add(t.policies, asdict(record))

    def watch_with(self, watching: Watching) -> None:
        """From now on a monitor watches its plant, in the place of any before."""
        values = {
            "monitor": watching.monitor,
            "since": watching.since,
            "sequence": watching.sequence,
            "kept": _text(watching.kept),
        }
        changed = self.connection.execute(
            update(t.watching).where(t.watching.c.plant == watching.plant).values(values)
        )
        if changed.rowcount == 0:
            self._add(t.watching, asdict(watching))
        self._wrote(t.watching, t.watching.c.plant == watching.plant)

    def advance(self, before: Watching, kept: dict[str, Json], seen: Sequence[Watch]) -> bool:
        """Move a monitor on over what it has seen; False, and nothing is done, if it does not stand
        where it stood."""
        where = (
            t.watching.c.plant == before.plant,
            t.watching.c.monitor == before.monitor,
            t.watching.c.sequence == before.sequence,
        )
        values = {"sequence": before.sequence + len(seen), "kept": _text(kept)}
        if self.connection.execute(update(t.watching).where(*where).values(values)).rowcount != 1:
            return False
        self._wrote(t.watching, t.watching.c.plant == before.plant)
        for watch in seen:
            self._add(t.watches, asdict(watch))
        return True

    def add_alarm(self, record: AlarmRecord) -> None:
        self._add(t.alarms, asdict(record))

    def update_alarm(self, alarm: str, **values: str | None) -> bool:
        """Give an open alarm its diagnosis or its trial, or close it; False if it is closed."""
        where = t.alarms.c.id == alarm, t.alarms.c.closed_at.is_(None)
        changed = self.connection.execute(update(t.alarms).where(*where).values(values))
        if changed.rowcount == 1:
            self._wrote(t.alarms, t.alarms.c.id == alarm)
        return changed.rowcount == 1

    def remember(
        self, scope: str, key: str, request: str, response: dict[str, Json], now: str
    ) -> None:
        """Keep the response to a request under its idempotency key."""
        self._add(
            t.idempotency,
            {
                "scope": scope,
                "key": key,
                "request_digest": request,
                "response": json.dumps(response),
                "at": now,
            },
        )

    def forget_answers(self, answers: Sequence[tuple[str, str, str]]) -> None:
        """Let go of answers under idempotency keys: scope, key and time of each."""
        self.connection.execute(
            _FORGET_ANSWER, [{"of": scope, "under": key, "since": at} for scope, key, at in answers]
        )

    def append_audit(
        self,
        *,
        at: str,
        kind: str,
        actor: str,
        plant: str | None,
        subject: str,
        facts: dict[str, Json],
    ) -> AuditEntry:
        """Add the next entry of the log."""
        head = self.connection.execute(_LOCK_HEAD).one()
        entry = AuditEntry(head.size + 1, at, kind, actor, plant, subject, facts, self.written)
        tree = self._grow(Frontier.from_bytes(head.size, head.frontier), entry)
        self.connection.execute(
            _MOVE_HEAD, {"new_size": tree.size, "new_frontier": tree.to_bytes()}
        )
        self.written = {}
        return entry

    def add_import(self, record: ImportRecord) -> None:
        self._add(t.imports, asdict(record))

    def add_row(self, table: Table, row: Mapping[str, Any]) -> None:
        """Add a row as it was stored elsewhere, and name it."""
        values = stored(table, row)
        self.connection.execute(_INSERT[table.name], values)
        self._note(table, values)

    def put_row(self, table: Table, row: Mapping[str, Any]) -> None:
        """Put a row back that the log names already."""
        self.connection.execute(_INSERT[table.name], stored(table, row))

    def put_log(self, entries: Iterable[AuditEntry]) -> Frontier:
        """Put a whole log back, and make its tree anew."""
        tree = Frontier(0, ())
        for entry in entries:
            tree = self._grow(tree, entry)
        self.connection.execute(
            _MOVE_HEAD, {"new_size": tree.size, "new_frontier": tree.to_bytes()}
        )
        return tree

    def _grow(self, tree: Frontier, entry: AuditEntry) -> Frontier:
        """Add an entry and the nodes of the tree that it completes; the tree with it."""
        grown, completed = tree.append(leaf_hash(entry_bytes(entry)))
        self._add(t.audit, asdict(entry))
        nodes = [{"node": number_of(node), "hash": made} for node, made in completed.items()]
        self.connection.execute(_INSERT[t.audit_tree.name], nodes)
        return grown

    def add_audit_key(self, key: AuditKey) -> None:
        """Keep the public key that signs the log from now on."""
        self._add(t.audit_key, {"id": 1 + len(self.audit_keys()), **asdict(key)})

    def _add(self, table: Table, values: dict[str, Any]) -> None:
        stored = {k: _text(v) if k in _JSON and v is not None else v for k, v in values.items()}
        self.connection.execute(_INSERT[table.name], stored)
        if table is not t.jobs:  # a job is named once it is final
            self._note(table, stored)

    def _wrote(self, table: Table, where: ColumnElement[bool]) -> None:
        """Note a row that was changed."""
        self._note(table, self.connection.execute(select(table).where(where)).mappings().one())

    def _note(self, table: Table, stored: Mapping[str, Any] | RowMapping) -> None:
        if table.name in KEYS:
            row = plain(table, stored)
            self.written[row_name(table.name, row)] = row_digest(table.name, row)


@contextmanager
def writing(database: Database) -> Iterator[Writer]:
    """A writer in a transaction that commits when it is left without an error, if the log tells of
    all that was written."""
    with database.write() as connection:
        writer = Writer(connection)
        yield writer
        if writer.written:
            raise BrokenChain(f"no entry of the log tells of {', '.join(writer.written)}")


def _text(document: Any) -> str:
    return canonical_bytes(document).decode()


def _twins(digest: str) -> Select[Any]:
    holds = select(t.episodes.c.samples_digest).where(t.episodes.c.digest == digest)
    return select(t.episodes.c.digest).where(t.episodes.c.samples_digest.in_(holds))


def record_of(kind: type[R], row: RowMapping) -> R:
    """A row as a record, its documents read."""
    return kind(**{k: json.loads(v) if k in _JSON and v is not None else v for k, v in row.items()})
