"""Submit a trial: freeze the gate, the incumbent and the held-out episodes, which count as used
from then on."""

from __future__ import annotations

from trueup.canonical import Json
from trueup.episode.role import HELD_OUT, Role
from trueup.errors import BadGate, RoleRefused
from trueup.gate.line import BESIDE, budget_of
from trueup_service.actions import find
from trueup_service.actions.gate_line import disclosed, require_in_force
from trueup_service.actions.submission import Submission, digests_of
from trueup_service.errors import HeldOutSpent
from trueup_service.registry.records import EpisodeRecord, JobRecord


def submit_gate(s: Submission) -> JobRecord:
    """Submit a trial of a candidate against what serves now, by the plant's gate in force.

    Raises NotFound, GateSuperseded, HeldOutSpent, RoleRefused, BadGate.
    """
    tx, plant = s.tx, s.plant
    candidate = find.artifact(tx, plant, str(s.request["candidate"]))
    gate = find.gate(tx, plant, str(s.request["gate"]))
    tx.plants.lock(plant)
    tx.lock_name("uses of held-out episodes")  # which are counted over all plants
    require_in_force(tx, plant, gate)
    held_out = _not_fitted(s, s.safeguarded(*HELD_OUT))
    if not held_out:
        raise BadGate(
            "there is no held-out episode to judge on",
            hint="Upload one whose metadata says role = validation.",
        )
    budget = budget_of(gate.document)
    uses = {e.digest: tx.jobs.count_uses(e.digest, "gate") for e in held_out}
    spent = [digest for digest, used in uses.items() if used >= budget]
    episodes = [e for e in held_out if e.digest not in spent]
    if not episodes or (spent and s.names_episodes):
        raise HeldOutSpent(
            f"{len(spent)} held-out episodes were used {budget} times, as often as the gate allows",
            spent=spent[:10],
        )
    digests = digests_of(episodes)
    now = find.serving(tx, plant)
    frozen: dict[str, Json] = {
        "candidate": candidate.digest,
        "gate": gate.digest,
        "episodes": list(digests),
        "uses": [uses[digest] + 1 for digest in digests],
        **disclosed(tx, plant, gate, candidate.digest, digests),
        "beside": _other_candidates(s, candidate.digest),
        **({"scales": True} if s.request.get("scales") else {}),
        **({"spent": list(spent)} if spent else {}),
        "incumbent": now.artifact,
        "generation": now.generation,
    }
    record = s.enqueue("gate", frozen)
    # The episodes count as used from now on, so that many trials at once do not overspend them.
    tx.jobs.add_reads(s.job, digests, "gate")
    return record


def _not_fitted(s: Submission, episodes: list[EpisodeRecord]) -> list[EpisodeRecord]:
    """The episodes whose samples did not also come in as an adaptation episode, from which a fit
    may have been made. Raises RoleRefused where one that the request names did."""
    fitted = s.tx.episodes.samples_of_role(s.plant, Role.ADAPTATION)
    seen = [e for e in episodes if e.samples_digest in fitted]
    if seen and s.names_episodes:
        raise RoleRefused(
            (
                f"episode {seen[0].digest[:12]} holds the samples of an adaptation episode, from "
                "which models are fitted"
            ),
            role=seen[0].role,
            digest=seen[0].digest,
        )
    return [e for e in episodes if e not in seen]


def _other_candidates(s: Submission, candidate: str) -> list[Json]:
    """Candidates besides this one that wait for their verdict, and then those that were rejected,
    the newest first, at most BESIDE together."""
    waiting = s.tx.jobs.candidates_on_trial(s.plant)
    rejected = s.tx.decisions.rejected_candidates(s.plant, BESIDE + 1)
    others = [c for c in dict.fromkeys([*waiting, *rejected]) if c != candidate]
    return list(others[:BESIDE])
