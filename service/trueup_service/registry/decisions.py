"""Decisions of gates, and their approvals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Select, bindparam, func, select

from trueup_service.registry import tables as t
from trueup_service.registry.records import Approval, DecisionRecord
from trueup_service.registry.repository import Repository, TableGateway


def _concerning(condition: ColumnElement[bool]) -> Select[Any]:
    """Decisions of a plant, `of_plant`, on any of some `candidates`, and those of all plants on any
    of some episodes, `digests`."""
    of, reads = t.decisions.c, t.job_reads.c
    on_candidates = (of.plant == bindparam("of_plant")) & of.candidate.in_(
        bindparam("candidates", expanding=True)
    )
    on_episodes = select(reads.job).where(
        reads.purpose == "gate", reads.digest.in_(bindparam("digests", expanding=True))
    )
    return select(t.decisions).where(condition, on_candidates | of.job.in_(on_episodes))


_REJECTED = _concerning(t.decisions.c.accepted.is_(False))
_APPROVALS = (
    select(t.approvals)
    .where(
        t.approvals.c.plant == bindparam("plant"), t.approvals.c.decision == bindparam("decision")
    )
    .order_by(t.approvals.c.at, t.approvals.c.token)
)


class Decisions(Repository[DecisionRecord]):
    """Decisions on candidates."""

    table, record = t.decisions, DecisionRecord

    def __init__(self, gateway: TableGateway) -> None:
        super().__init__(gateway)
        self._read: dict[str, DecisionRecord] = {}  # which never changes

    def get(self, digest: str) -> DecisionRecord | None:
        """A decision of any plant by its digest."""
        decision = self._read.get(digest) or self._by(digest=digest)
        if decision is not None:
            self._read[digest] = decision
        return decision

    def page(self, plant: str, before: str, limit: int) -> list[DecisionRecord]:
        """Decisions made before a time, the newest first."""
        of = t.decisions.c
        return self._newest(of.created_at, of.digest, before, limit, of.plant == plant)

    def on_candidate_or_episodes(
        self, plant: str, candidate: str, episodes: Sequence[str]
    ) -> list[DecisionRecord]:
        """Decisions on a candidate, and those of every plant of the same project on any of these
        episodes, in the order in which they were made."""
        project = self._connection.scalar(
            select(t.plants.c.project).where(t.plants.c.name == plant)
        )
        of_project = select(t.plants.c.name).where(
            t.plants.c.project.is_(None) if project is None else t.plants.c.project == project
        )
        query = _concerning(t.decisions.c.plant.in_(of_project))
        return self._concerning(query, plant, [candidate], episodes)

    def rejections_of(
        self, plant: str, candidates: Sequence[str], episodes: Sequence[str]
    ) -> list[DecisionRecord]:
        """Rejections of some candidates, and those of all plants of all projects on any of these
        episodes, in the order in which they were made."""
        return self._concerning(_REJECTED, plant, candidates, episodes)

    def _concerning(
        self, query: Select[Any], plant: str, candidates: Sequence[str], episodes: Sequence[str]
    ) -> list[DecisionRecord]:
        of_plant = {"of_plant": plant, "candidates": list(candidates)}
        rows = self._gateway.in_parts(query, "digests", episodes, of_plant)
        by_digest = {d.digest: d for d in map(self._record, rows)}
        return sorted(by_digest.values(), key=lambda d: (d.created_at, d.digest))

    def rejected_candidates(self, plant: str, limit: int) -> list[str]:
        """Candidates of a plant that were rejected, the last rejected first."""
        of = t.decisions.c
        query = (
            select(of.candidate)
            .where(of.plant == plant, of.accepted.is_(False))
            .group_by(of.candidate)
            .order_by(func.max(of.created_at).desc(), of.candidate)
        )
        return list(self._connection.scalars(query.limit(limit)))

    def newest_on(self, plant: str, candidates: Sequence[str]) -> dict[str, DecisionRecord]:
        """The newest decision on each of some candidates, by candidate; without those that were
        never judged."""
        of = t.decisions.c
        newest_first = (of.created_at.desc(), of.digest)
        place = func.row_number().over(partition_by=of.candidate, order_by=newest_first)
        placed = (
            select(of.digest, place.label("place"))
            .where(of.plant == plant, of.candidate.in_(candidates))
            .subquery()
        )
        newest = select(placed.c.digest).where(placed.c.place == 1)
        query = select(t.decisions).where(of.plant == plant, of.digest.in_(newest))
        return {d.candidate: d for d in self._all(query)}

    def between(self, plant: str, artifacts: Sequence[str], limit: int) -> list[DecisionRecord]:
        """The newest decisions of a plant that name one of some artifacts as candidate or
        incumbent, in the order in which they were made."""
        of = t.decisions.c
        named = of.candidate.in_(artifacts) | of.incumbent.in_(artifacts)
        query = select(t.decisions).where(of.plant == plant, named)
        newest = self._all(query.order_by(of.created_at.desc(), of.digest.desc()).limit(limit))
        return newest[::-1]

    def naming(self, plant: str, artifact: str) -> list[str]:
        """The digests of the decisions that name an artifact as candidate or incumbent."""
        query = select(t.decisions.c.digest).where(
            t.decisions.c.plant == plant,
            (t.decisions.c.candidate == artifact) | (t.decisions.c.incumbent == artifact),
        )
        return list(self._connection.scalars(query))


class Approvals(Repository[Approval]):
    """Approvals of decisions for promotion."""

    table, record = t.approvals, Approval

    def of_decision(self, plant: str, decision: str) -> list[Approval]:
        """The approvals of a decision, in the order of their time."""
        return self._all(_APPROVALS, {"plant": plant, "decision": decision})
