"""What a job reads. Each read is recorded first, and refused if the episode's role forbids it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trueup.artifact.artifact import unpack
from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import BadEpisode
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.randomise.study import IDENTIFICATION, Context
from trueup_service.actions import find
from trueup_service.actions.switchback import load_artifact
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts


def read_plant(parts: Parts, job: JobRecord) -> Plant:
    """Returns the job's plant."""
    with reading(parts.database) as tx:
        return Plant.from_document(find.plant(tx, job.plant).document)


def read_episodes(
    parts: Parts,
    job: JobRecord,
    plant: Plant,
    roles: Sequence[Role],
    progress: Callable[[float], None],
    digests: Sequence[str] | None = None,
) -> list[Episode]:
    """Returns the episodes that the job's request names, or some of them by their `digests`.

    Raises RoleRefused if a role is not one of `roles`, and BadEpisode if the stored bytes are not
    what their digest names.
    """
    if digests is None:
        named: Any = job.request["episodes"]
        digests = named
    with writing(parts.database) as tx:
        tx.jobs.add_reads(job.id, digests, job.kind)
    episodes = []
    for count, digest in enumerate(digests):
        episode = read_episode(parts.blobs.get(digest), plant.layout).require(*roles)
        if episode.digest != digest:
            raise BadEpisode(
                "the stored bytes are not the episode that was ingested",
                expected=digest,
                found=episode.digest,
            )
        episodes.append(episode)
        progress((count + 1) / len(digests))
    return episodes


def read_predictor(parts: Parts, job: JobRecord, digest: str) -> Predictor:
    """Returns a predictor by its artifact's digest."""
    with writing(parts.database) as tx:
        record = find.artifact(tx, job.plant, digest)
        tx.jobs.add_reads(job.id, [digest], "artifact")
    return unpack(load_artifact(parts.blobs, record), digest)


@dataclass(frozen=True, slots=True)
class Versions:
    """The versions of a study: predictors `of` each by its name, and the digests of their
    `artifacts`."""

    of: dict[str, Predictor]
    artifacts: dict[str, Json]


def read_versions(parts: Parts, job: JobRecord) -> tuple[Versions, tuple[str, Predictor]]:
    """Returns the versions that a study's request names, and the one that stands in for the
    machine, with its name; it is the same object where it is one of them."""
    digests: Any = job.request["versions"]
    machine: Any = job.request["machine"]
    with reading(parts.database) as tx:
        records = {d: find.artifact(tx, job.plant, d) for d in (*digests, machine)}
    names = {digest: f"v{r.version} {r.kind}" for digest, r in records.items()}
    predictors = {digest: read_predictor(parts, job, digest) for digest in records}
    versions = Versions({names[d]: predictors[d] for d in digests}, {names[d]: d for d in records})
    return versions, (names[machine], predictors[machine])


def context_of(request: Mapping[str, Any]) -> Context:
    """Returns where a request takes the context of a conditioned predictor from."""
    given = request.get("context") or {}
    return Context(given.get("by", IDENTIFICATION), given.get("parameters"))


def sources(episodes: Sequence[Episode]) -> list[Json]:
    """Returns episodes as provenance names them: digest, role, collection conditions."""
    return [
        {"sha256": e.digest, "role": str(e.role), "conditions": dict(e.conditions)}
        for e in episodes
    ]
