"""Submit a study of versions: how they compare on recordings, in open and in closed loop."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json
from trueup.episode.role import HELD_OUT, Role
from trueup.errors import NotIdentifiable
from trueup_service.actions import find
from trueup_service.actions.submission import Submission, digests_of, require_some
from trueup_service.registry.records import ArtifactRecord, EpisodeRecord, JobRecord, JobState

TOLD = 10  # earlier diagnoses beside a consistency study
FEWEST = 2  # recordings that could agree
# as which a version stands in for the machine, the first that there is
STAND_INS = ("corrected", "identified", "nominal")


def submit_comparison(s: Submission) -> JobRecord:
    """Submit a comparison of two versions on the named episodes, or on all held-out ones. Raises
    NotFound, NotIdentifiable."""
    both: dict[str, Json] = {
        which: find.artifact(s.tx, s.plant, str(s.request[which])).digest
        for which in ("first", "second")
    }
    return _submit_on_shown(s, "compare", both, s.episodes(*Role, otherwise=HELD_OUT))


def submit_openloop(s: Submission) -> JobRecord:
    """Submit rollouts of some versions, of the nominal one and what serves by default, on the named
    episodes, or on all of the role test, else on all held-out ones.

    Raises NotFound, NotIdentifiable.
    """
    episodes = s.episodes(*Role, otherwise=(Role.TEST,))
    if not episodes:
        episodes = s.episodes(*Role, otherwise=HELD_OUT)
    frozen = {**s.request, **_versions(s)}
    return _submit_on_shown(s, "openloop", frozen, episodes)


def submit_closedloop(s: Submission) -> JobRecord:
    """Submit runs of some versions, of the nominal one and what serves by default, in closed loop
    with a fixed planner, along a declared reference or as far as adaptation episodes travelled.

    Raises NotFound, RoleRefused, NotIdentifiable.
    """
    find.plant_digest(s.tx, s.plant)
    episodes = [] if s.request.get("reference") else s.episodes(Role.ADAPTATION)
    if not s.request.get("reference"):
        require_some(episodes, Role.ADAPTATION, "adaptation episode to take the travel from")
    frozen = {**s.request, **_versions(s), "episodes": list(digests_of(episodes))}
    return s.enqueue("closedloop", frozen)


def submit_excitation(s: Submission) -> JobRecord:
    """Submit the design of an excitation from the named adaptation episodes, or from all of them:
    for the model of the named diagnosis or of the newest; with a `spread`, or where nothing has
    been diagnosed, for the declared model.

    Raises NotFound, RoleRefused, NotIdentifiable.
    """
    find.plant_digest(s.tx, s.plant)
    episodes = s.safeguarded(Role.ADAPTATION, optional=True)
    diagnosis = _diagnosis(s)
    if diagnosis is None and s.request["goal"] == "split":
        raise NotIdentifiable(
            "there are no alternatives to separate without a diagnosis",
            hint="Diagnose the plant first, and leave out `spread`.",
        )
    frozen: dict[str, Json] = {**s.request, "episodes": list(digests_of(episodes))}
    if diagnosis is not None:
        frozen["diagnosis"] = diagnosis.id
    return s.enqueue("excite", frozen)


def _diagnosis(s: Submission) -> JobRecord | None:
    """The diagnosis that a request names, else the newest; None with a `spread`. Raises
    NotFound."""
    named = s.request.get("diagnosis")
    if named is None:
        return (
            None
            if s.request.get("spread") is not None
            else s.tx.jobs.last_succeeded(s.plant, "diagnose")
        )
    job = find.job(s.tx, str(named))
    if (job.plant, job.kind, job.state) != (s.plant, "diagnose", JobState.SUCCEEDED):
        raise find.not_found("diagnosis", str(named))
    return job


def submit_consistency(s: Submission) -> JobRecord:
    """Submit a study of whether recordings agree on the numbers of a version, by default of what
    describes the machine best; the newest diagnoses of the plant are told beside it.

    Raises NotFound, RoleRefused, NotIdentifiable.
    """
    find.plant_digest(s.tx, s.plant)
    named: Any = s.request.get("version")
    version = find.artifact(s.tx, s.plant, named) if named else _stand_in(s)
    earlier = s.tx.jobs.newest_succeeded(s.plant, "diagnose", TOLD)
    frozen: dict[str, Json] = {
        "versions": [version.digest],
        "diagnoses": s.request["diagnoses"],
        "earlier": [job.id for job in reversed(earlier)],
    }
    episodes = s.episodes(Role.ADAPTATION, Role.VALIDATION)
    if len(digests_of(episodes)) < FEWEST:
        raise NotIdentifiable(
            "there are not two recordings that could agree",
            hint="Upload two recordings of the same machine at least.",
        )
    return _submit_on_shown(s, "consistency", frozen, episodes)


def _versions(s: Submission) -> dict[str, Json]:
    """The versions of a study, and the one that stands in for the machine: the newest diagnosis,
    else the newest identification, else the nominal model."""
    named: Any = s.request.get("versions")
    serving = find.serving(s.tx, s.plant).artifact
    first = find.version(s.tx, s.plant, 1).digest
    chosen = [find.artifact(s.tx, s.plant, d).digest for d in named or (first, serving)]
    machine: Any = s.request.get("machine")
    stands_in = find.artifact(s.tx, s.plant, machine) if machine else _stand_in(s)
    return {"versions": list(dict.fromkeys(chosen)), "machine": stands_in.digest}


def _stand_in(s: Submission) -> ArtifactRecord:
    newest = (s.tx.artifacts.newest_of_kind(s.plant, kind) for kind in STAND_INS)
    record = next((r for r in newest if r is not None), None)
    return record or find.version(s.tx, s.plant, 1)


def _submit_on_shown(
    s: Submission, kind: str, frozen: dict[str, Json], episodes: list[EpisodeRecord]
) -> JobRecord:
    """Submit a study that shows versions' errors on episodes, which later decisions on these
    disclose."""
    s.tx.plants.lock(s.plant)
    if not episodes:
        raise NotIdentifiable(
            "there is no held-out episode to compare on",
            hint="Upload one whose metadata says role = validation.",
        )
    digests = digests_of(episodes)
    record = s.enqueue(kind, {**frozen, "episodes": list(digests)})
    s.tx.jobs.add_reads(s.job, digests, "compare")
    return record
