"""Decisions of gates, and their approvals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Select, bindparam, func, select

from trueup_service.registry import tables as t
from trueup_service.registry.records import Approval, DecisionRecord
from trueup_service.registry.repository import Repository


def _on_episodes(condition: ColumnElement[bool]) -> Select[Any]:
    """Decisions on any of some episodes, `digests`."""
    reads = select(t.job_reads.c.job).where(
        t.job_reads.c.purpose == "gate",
        t.job_reads.c.digest.in_(bindparam("digests", expanding=True)),
    )
    return select(t.decisions).where(t.decisions.c.job.in_(reads), condition)


_IS_REJECTED = t.decisions.c.accepted.is_(False)
_REJECTED_ON_EPISODES = _on_episodes(_IS_REJECTED)
_DECISION = select(t.decisions).where(t.decisions.c.digest == bindparam("digest"))


class Decisions(Repository[DecisionRecord]):
    """Decisions on candidates."""

    table, record = t.decisions, DecisionRecord

    def get(self, digest: str) -> DecisionRecord | None:
        """A decision of any plant by its digest."""
        return self._one(_DECISION, digest=digest)

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
        of_plants = t.decisions.c.plant.in_(of_project)
        return self._concerning([candidate], plant, episodes, of_plants, _on_episodes(of_plants))

    def rejections_of(
        self, plant: str, candidates: Sequence[str], episodes: Sequence[str]
    ) -> list[DecisionRecord]:
        """Rejections of some candidates, and those of all plants of all projects on any of these
        episodes, in the order in which they were made."""
        return self._concerning(candidates, plant, episodes, _IS_REJECTED, _REJECTED_ON_EPISODES)

    def _concerning(
        self,
        candidates: Sequence[str],
        plant: str,
        episodes: Sequence[str],
        condition: ColumnElement[bool],
        on_episodes: Select[Any],
    ) -> list[DecisionRecord]:
        on_candidates = select(t.decisions).where(
            t.decisions.c.plant == plant, t.decisions.c.candidate.in_(candidates), condition
        )
        decisions = self._all(on_candidates)
        decisions += map(self._record, self._gateway.in_parts(on_episodes, "digests", episodes))
        by_digest = {decision.digest: decision for decision in decisions}
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
        of = t.approvals.c
        query = select(t.approvals).where(of.plant == plant, of.decision == decision)
        return self._all(query.order_by(of.at, of.token))
