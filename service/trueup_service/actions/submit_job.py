"""Submit a job: freeze everything that it will read, and hand it to the engine in the same
transaction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trueup.canonical import Json
from trueup.episode.role import HEALTHY, HELD_OUT, WATCHED, Role
from trueup.errors import BadGate, NotIdentifiable, RoleRefused
from trueup.gate.line import BESIDE, budget_of
from trueup_service.actions import find
from trueup_service.actions.gate_line import disclosed, require_in_force
from trueup_service.actor_context import ActorContext
from trueup_service.errors import HeldOutSpent
from trueup_service.jobs import JobQueue
from trueup_service.registry.records import EpisodeRecord, JobRecord, JobState
from trueup_service.registry.transaction import Transaction

# One episode differs by luck alone by as much as an alarm takes.
LEAST_VALIDATED = 5  # episodes


def submit_fit(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    """Submit a fit of `method` from the named adaptation episodes, or from all of them. Raises
    NotFound, RoleRefused, NotIdentifiable."""
    find.plant_digest(tx, plant)
    episodes = _episodes(tx, plant, request.get("episodes"), (Role.ADAPTATION,))
    if not episodes:
        raise NotIdentifiable(
            "there is no adaptation episode to fit",
            hint="Upload one whose metadata says role = adaptation.",
        )
    frozen = {**request, "episodes": _digests(episodes), "parent": find.serving(tx, plant).artifact}
    return _submit(tx, queue, job, plant, "fit", frozen, context)


def submit_gate(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    """Submit a trial of a candidate against what serves now, by the plant's gate in force.

    Raises NotFound, GateSuperseded, HeldOutSpent, RoleRefused, BadGate.
    """
    candidate = find.artifact(tx, plant, str(request["candidate"]))
    gate = find.gate(tx, plant, str(request["gate"]))
    tx.plants.lock(plant)
    tx.lock_name("uses of held-out episodes")  # which are counted over all plants
    require_in_force(tx, plant, gate)
    named = request.get("episodes")
    held_out = _not_fitted(
        tx, plant, _episodes(tx, plant, named, HELD_OUT), named=named is not None
    )
    if not held_out:
        raise BadGate(
            "there is no held-out episode to judge on",
            hint="Upload one whose metadata says role = validation.",
        )
    budget = budget_of(gate.document)
    uses = {e.digest: tx.jobs.count_uses(e.digest, "gate") for e in held_out}
    spent = [digest for digest, used in uses.items() if used >= budget]
    episodes = [e for e in held_out if e.digest not in spent]
    if not episodes or (spent and named is not None):
        raise HeldOutSpent(
            f"{len(spent)} held-out episodes were used {budget} times, as often as the gate allows",
            spent=spent[:10],
        )
    digests = _digests(episodes)
    now = find.serving(tx, plant)
    frozen: dict[str, Json] = {
        "candidate": candidate.digest,
        "gate": gate.digest,
        "episodes": digests,
        "uses": [uses[digest] + 1 for digest in digests],
        **disclosed(tx, plant, gate, candidate.digest, digests),
        "beside": _other_candidates(tx, plant, candidate.digest),
        **({"scales": True} if request.get("scales") else {}),
        **({"spent": list(spent)} if spent else {}),
        "incumbent": now.artifact,
        "generation": now.generation,
    }
    record = _submit(tx, queue, job, plant, "gate", frozen, context)
    # The episodes count as used from now on, so that many trials at once do not overspend them.
    tx.jobs.add_reads(job, digests, "gate")
    return record


def submit_diagnosis(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    """Submit a diagnosis of the nominal model from adaptation and validation episodes. Raises
    NotFound, RoleRefused, NotIdentifiable."""
    return _submit_on_both(tx, queue, job, plant, "diagnose", request, context)


def submit_blindtrial(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    """Submit a blind trial that imitates adaptation and validation episodes. Raises NotFound,
    RoleRefused, NotIdentifiable."""
    return _submit_on_both(tx, queue, job, plant, "blindtrial", request, context)


def _submit_on_both(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    kind: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    find.plant_digest(tx, plant)
    episodes = _episodes(tx, plant, request.get("episodes"), (Role.ADAPTATION, Role.VALIDATION))
    missing = {Role.ADAPTATION, Role.VALIDATION} - {Role(e.role) for e in episodes}
    if missing:
        role = min(missing)
        raise NotIdentifiable(
            f"there is no {role} episode to start from",
            hint=f"Upload one whose metadata says role = {role}.",
        )
    frozen = {**request, "episodes": _digests(episodes), "parent": find.serving(tx, plant).artifact}
    return _submit(tx, queue, job, plant, kind, frozen, context)


def submit_calibration(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    """Submit the calibration of a monitor of what serves now, on the named healthy episodes, or on
    all of the role reference. Raises NotFound, RoleRefused, NotIdentifiable."""
    find.plant_digest(tx, plant)
    named = request.get("episodes")
    episodes = _episodes(tx, plant, named, (Role.REFERENCE,) if named is None else HEALTHY)
    if not episodes:
        raise NotIdentifiable(
            "there is no reference episode",
            hint="Upload healthy operation whose metadata says role = reference.",
        )
    frozen = {
        **request,
        "episodes": _digests(episodes),
        "artifact": find.serving(tx, plant).artifact,
    }
    return _submit(tx, queue, job, plant, "calibrate", frozen, context)


def submit_watch(
    tx: Transaction, queue: JobQueue, job: str, plant: str, context: ActorContext
) -> JobRecord | None:
    """Submit a look at the episodes that the plant's monitor has not seen. Returns None where there
    are none, a look waits already, or no monitor watches what serves."""
    watching = tx.watches.current(plant)
    if watching is None or tx.jobs.is_queued(plant, "watch"):
        return None
    if find.monitor(tx, plant, watching.monitor).artifact != find.serving(tx, plant).artifact:
        return None
    if not tx.episodes.unwatched(watching, WATCHED, 1):
        return None
    return _submit(tx, queue, job, plant, "watch", {"monitor": watching.monitor}, context)


def submit_validation(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    """Submit a validation of what serves on the episodes held out since its promotion, beside those
    on which the promotion was judged.

    Raises NotIdentifiable where fewer than LEAST_VALIDATED were held out.
    """
    now = find.serving(tx, plant)
    judged: Any = (
        [] if now.decision is None else find.decision(tx, plant, now.decision).document["episodes"]
    )
    gate: Any = (
        {}
        if now.decision is None
        else find.gate(tx, plant, find.decision(tx, plant, now.decision).gate).document
    )
    new = [
        e
        for e in tx.episodes.of_roles(plant, HELD_OUT, ingested_after=now.at)
        if e.digest not in judged
    ]
    if len(new) < LEAST_VALIDATED:
        hint = f"Upload {LEAST_VALIDATED} episodes with the role validation at least."
        raise NotIdentifiable(
            f"only {len(new)} episodes were held out since this model serves", hint=hint
        )
    frozen: dict[str, Json] = {
        "artifact": now.artifact,
        "episodes": [*judged, *_digests(new)],
        "new": list(_digests(new)),
        "conditions": gate.get("conditions", []),
    }
    return _submit(tx, queue, job, plant, "validate", frozen, context)


def submit_recomputation(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    """Submit the recomputation of a decision from its bytes. Raises NotFound."""
    made = find.decision(tx, plant, str(request["decision"]))
    frozen: dict[str, Json] = {"decision": made.digest, "episodes": made.document["episodes"]}
    return _submit(tx, queue, job, plant, "recompute", frozen, context)


def submit_comparison(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    request: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    """Submit a comparison of two versions on the named episodes, or on all held-out ones. Raises
    NotFound, NotIdentifiable."""
    tx.plants.lock(plant)
    both: dict[str, Json] = {
        which: find.artifact(tx, plant, str(request[which])).digest for which in ("first", "second")
    }
    episodes = _episodes(
        tx,
        plant,
        request.get("episodes"),
        tuple(Role) if request.get("episodes") is not None else HELD_OUT,
    )
    if not episodes:
        raise NotIdentifiable(
            "there is no held-out episode to compare on",
            hint="Upload one whose metadata says role = validation.",
        )
    record = _submit(
        tx, queue, job, plant, "compare", {**both, "episodes": _digests(episodes)}, context
    )
    # From now on decisions disclose the comparison.
    tx.jobs.add_reads(job, _digests(episodes), "compare")
    return record


SUBMIT = {
    "validate": submit_validation,
    "calibrate": submit_calibration,
    "fit": submit_fit,
    "gate": submit_gate,
    "diagnose": submit_diagnosis,
    "blindtrial": submit_blindtrial,
    "recompute": submit_recomputation,
    "compare": submit_comparison,
}


def _episodes(
    tx: Transaction, plant: str, named: Json, roles: Sequence[Role]
) -> list[EpisodeRecord]:
    if named is None:
        return tx.episodes.of_roles(plant, roles)
    episodes = [find.episode(tx, plant, str(digest)) for digest in named]  # type: ignore[union-attr]
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


def _not_fitted(
    tx: Transaction, plant: str, episodes: list[EpisodeRecord], *, named: bool
) -> list[EpisodeRecord]:
    """The episodes whose samples did not also come in as an adaptation episode, from which a fit
    may have been made. Raises RoleRefused where one that was `named` did."""
    fitted = tx.episodes.samples_of_role(plant, Role.ADAPTATION)
    seen = [e for e in episodes if e.samples_digest in fitted]
    if seen and named:
        raise RoleRefused(
            (
                f"episode {seen[0].digest[:12]} holds the samples of an adaptation episode, from "
                "which models are fitted"
            ),
            role=seen[0].role,
            digest=seen[0].digest,
        )
    return [e for e in episodes if e not in seen]


def _other_candidates(tx: Transaction, plant: str, candidate: str) -> list[Json]:
    """Candidates besides this one that wait for their verdict, and then those that were rejected,
    the newest first, at most BESIDE together."""
    waiting = tx.jobs.candidates_on_trial(plant)
    rejected = tx.decisions.rejected_candidates(plant, BESIDE + 1)
    others = [c for c in dict.fromkeys([*waiting, *rejected]) if c != candidate]
    return list(others[:BESIDE])


def _digests(episodes: Sequence[EpisodeRecord]) -> list[str]:
    return list(dict.fromkeys(e.digest for e in episodes))


def _submit(
    tx: Transaction,
    queue: JobQueue,
    job: str,
    plant: str,
    kind: str,
    frozen: dict[str, Json],
    context: ActorContext,
) -> JobRecord:
    record = JobRecord(
        id=job,
        plant=plant,
        kind=kind,
        request=frozen,
        state=JobState.QUEUED,
        progress=0.0,
        stage="queued",
        result=None,
        created_at=context.now,
        created_by=context.actor,
        updated_at=context.now,
    )
    tx.jobs.add(record)
    queue.enqueue(tx.connection, job, kind, plant)
    tx.log.append(
        context,
        "job:submitted",
        plant=plant,
        subject=job,
        facts={"kind": kind, "operation": record.operation, "request": frozen},
    )
    return record
