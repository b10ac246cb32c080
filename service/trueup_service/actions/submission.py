"""Submission: a request for a job, before everything that it will read is frozen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json
from trueup.collect.required import refusal_of
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable, RoleRefused
from trueup.gate.policy import REQUIRE, UpdatePolicy
from trueup_service.actions import find
from trueup_service.actions.declare_policy import policy_of
from trueup_service.actor_context import ActorContext
from trueup_service.errors import NotSafeguarded
from trueup_service.jobs import JobQueue
from trueup_service.registry.records import EpisodeRecord, JobRecord, JobState
from trueup_service.registry.transaction import Transaction


@dataclass(frozen=True, slots=True)
class Submission:
    """A request for a job on a plant, the id that the job will have, and the transaction in which
    it is submitted."""

    tx: Transaction
    queue: JobQueue
    job: str
    plant: str
    request: dict[str, Json]
    context: ActorContext

    def episodes(
        self, *roles: Role, otherwise: Sequence[Role] = (), field: str = "episodes"
    ) -> list[EpisodeRecord]:
        """The episodes that the request names in a field, which have one of the roles; where it
        names none, all of these roles, or of `otherwise` if that is given.

        Raises NotFound, RoleRefused.
        """
        named = self.request.get(field)
        if named is None:
            return self.tx.episodes.of_roles(self.plant, otherwise or roles)
        digests = map(str, named)  # type: ignore[arg-type]
        episodes = [find.episode(self.tx, self.plant, digest) for digest in digests]
        for episode in episodes:
            if episode.role not in roles:
                raise RoleRefused(
                    (
                        f"episode {episode.digest[:12]} has the role {episode.role}, "
                        f"{' or '.join(roles)} is needed"
                    ),
                    role=episode.role,
                    digest=episode.digest,
                )
        return episodes

    def safeguarded(
        self, *roles: Role, field: str = "episodes", optional: bool = False
    ) -> list[EpisodeRecord]:
        """The episodes of these roles that the plant's policy lets be used: all, or where it
        requires safeguards those whose safeguards held.

        Raises NotSafeguarded for one that the request names in the field, and where no other is
        left, unless the job can do without.
        """
        episodes = self.episodes(*roles, field=field)
        kept = only_safeguarded(policy_of(self.tx, self.plant), episodes)
        refused = [e for e in episodes if e not in kept]
        named = self.request.get(field) is not None
        if refused and (named or not (kept or optional)):
            raise NotSafeguarded(
                "the plant's policy requires safeguards, and of episode "
                f"{refused[0].digest[:12]} {_refusal(refused[0])}",
                digest=refused[0].digest,
                refused=len(refused),
            )
        return kept

    @property
    def names_episodes(self) -> bool:
        """Whether the request says on which episodes."""
        return self.request.get("episodes") is not None

    def enqueue(self, kind: str, frozen: dict[str, Json]) -> JobRecord:
        """Add the job with what it will read, hand it to the engine, and log it."""
        record = JobRecord(
            id=self.job,
            plant=self.plant,
            kind=kind,
            request=frozen,
            state=JobState.QUEUED,
            progress=0.0,
            stage="queued",
            result=None,
            created_at=self.context.now,
            created_by=self.context.actor,
            updated_at=self.context.now,
        )
        self.tx.jobs.add(record)
        self.queue.enqueue(self.tx.connection, self.job, kind, self.plant)
        self.tx.log.append(
            self.context,
            "job:submitted",
            plant=self.plant,
            subject=self.job,
            facts={"kind": kind, "operation": record.operation, "request": frozen},
        )
        return record


def only_safeguarded(
    policy: UpdatePolicy | None, episodes: Sequence[EpisodeRecord]
) -> list[EpisodeRecord]:
    """The episodes that a policy lets be used: all, or where it requires safeguards those whose
    safeguards held."""
    if policy is None or policy.safeguards != REQUIRE:
        return list(episodes)
    return [e for e in episodes if _refusal(e) is None]


def _refusal(episode: EpisodeRecord) -> str | None:
    """Why an episode does not show safeguards that held, None where it does."""
    summary: Any = episode.summary
    return refusal_of(summary, summary.get("conditions") or {})


def digests_of(episodes: Sequence[EpisodeRecord]) -> list[str]:
    """The digests of episodes, each once."""
    return list(dict.fromkeys(e.digest for e in episodes))


def require_some(episodes: Sequence[EpisodeRecord], role: Role, purpose: str) -> None:
    """Raises NotIdentifiable where there is no episode for a purpose."""
    if not episodes:
        raise NotIdentifiable(
            f"there is no {purpose}", hint=f"Upload one whose metadata says role = {role}."
        )
