"""The gates of a plant in order: which one is in force, and what was known when a gate was
declared.

The order of events is that of the log and not of clocks, which may be wrong. What was imported came
before everything here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json
from trueup.gate.line import (
    LooserThan,
    alike,
    known,
    looser_than,
    past_of,
    rejects,
    selection,
    shown_candidates,
)
from trueup_service.actions import find
from trueup_service.errors import GateSuperseded
from trueup_service.registry.records import (
    NOTHING_CAME,
    DecisionRecord,
    GateRecord,
    JobRecord,
    JobState,
)
from trueup_service.registry.transaction import ReadTransaction

DECLARED, DECIDED, INGESTED = "gate:declared", "decision:made", "episode:ingested"


@dataclass(frozen=True, slots=True)
class Place:
    """A gate's place among the gates of its plant: the gate before it, the earlier gates than which
    it is looser and in what, and whether it is in force."""

    gate: GateRecord
    before: GateRecord | None
    looser_than: list[LooserThan]
    in_force: bool

    @property
    def looser(self) -> list[str]:
        """What is looser in the gate than in the one before it."""
        return next(
            (
                less.looser
                for less in self.looser_than
                if self.before is not None and less.gate == self.before.digest
            ),
            [],
        )


def place(tx: ReadTransaction, plant: str, digest: str | None = None) -> Place | None:
    """The place of a gate, or of the gate in force without a digest. None where there is no such
    gate."""
    line = tx.gates.in_order(plant)
    at = next(
        (i for i, gate in reversed(list(enumerate(line))) if digest in (None, gate.digest)), None
    )
    if at is None:
        return None
    than = looser_than([(gate.digest, gate.document) for gate in line[:at]], line[at].document)
    return Place(line[at], line[at - 1] if at else None, than, at == len(line) - 1)


def require_in_force(tx: ReadTransaction, plant: str, gate: GateRecord) -> None:
    """Raises GateSuperseded where another gate has been declared since."""
    last = tx.gates.in_order(plant)[-1]
    if last.digest != gate.digest:
        raise GateSuperseded(
            (
                f"gate {gate.digest[:12]} was superseded: {last.digest[:12]} is in force since "
                f"{last.created_at}"
            ),
            in_force=last.digest,
        )


def known_at(
    tx: ReadTransaction, plant: str, gate: GateRecord, candidate: str, episodes: Sequence[str]
) -> dict[str, Json]:
    """What was known of a candidate and its held-out episodes when a gate was declared."""
    return disclosed(tx, plant, gate, candidate, episodes)["known"]


def disclosed(
    tx: ReadTransaction, plant: str, gate: GateRecord, candidate: str, episodes: Sequence[str]
) -> dict[str, dict[str, Json]]:
    """What the decision of a trial must disclose: what was `known` of its candidate and its
    episodes when its gate was declared, and out of how many both are selected now (`selection`)."""
    declared = tx.log.positions(plant, DECLARED, [gate.digest]).get(gate.digest, 0)
    made, comparisons = (
        tx.decisions.on_candidate_or_episodes(plant, candidate, episodes),
        tx.jobs.reading(episodes, "compare"),
    )
    at: dict[str, int] = {}
    for other in {d.plant for d in made}:
        at |= tx.log.positions(other, DECIDED, [d.digest for d in made if d.plant == other])
    before = [
        d
        for d in made
        if at.get(d.digest, 0) < declared
        or (at.get(d.digest, 0) == declared == 0 and d.created_at < gate.created_at)
    ]
    before.sort(key=lambda d: (at.get(d.digest, 0), d.created_at, d.digest))
    pasts = [past_of(d.digest, d.plant, d.document) for d in before]
    outcomes = [
        d.accepted
        for d in made
        if d.plant == plant and d.candidate != candidate and at.get(d.digest, 0) > declared
    ]
    shown = sum(job.plant == plant and job.state not in NOTHING_CAME for job in comparisons)
    return {
        "known": known(
            plant, candidate, episodes, pasts, _compared(tx, candidate, comparisons, declared)
        ),
        "selection": selection(
            tx.episodes.count_held_out(plant), outcomes.count(True), outcomes.count(False), shown
        ),
    }


def _compared(
    tx: ReadTransaction, candidate: str, comparisons: Sequence[JobRecord], declared: int
) -> list[str]:
    """The ids of those comparisons that had shown the candidate's errors when the gate was
    declared."""
    jobs = [
        j
        for j in comparisons
        if j.state == JobState.SUCCEEDED and candidate in shown_candidates(j.request)
    ]
    ended: dict[str, int] = {}
    for plant in {j.plant for j in jobs}:
        ended |= tx.log.positions(plant, "job:finished", [j.id for j in jobs])
    return [j.id for j in jobs if ended.get(j.id, declared) < declared]


def rejections(tx: ReadTransaction, made: DecisionRecord) -> list[DecisionRecord]:
    """The decisions, whenever they were made, that rejected the candidate of a decision, or one
    with the same errors."""
    document: Any = made.document
    rejected = tx.decisions.rejections_of(
        made.plant, [made.candidate, *alike(document)], document["episodes"]
    )
    if not rejected:
        return []
    scoring = find.gate(tx, made.plant, made.gate).document["scoring"]
    return [
        other
        for other in rejected
        if rejects(
            other.document,
            document,
            same_scoring=find.gate(tx, other.plant, other.gate).document["scoring"] == scoring,
        )
    ]


def stale(
    tx: ReadTransaction, made: DecisionRecord, rejected: Sequence[DecisionRecord]
) -> list[str]:
    """The episodes of an accepted decision that did not come in after its gate was declared and
    after its candidate was rejected."""
    document: Any = made.document
    episodes: list[str] = document["episodes"]
    since = tx.log.positions(made.plant, DECLARED, [made.gate]).get(made.gate, 0)
    for other in rejected:
        since = max(
            since, tx.log.positions(other.plant, DECIDED, [other.digest]).get(other.digest, 0)
        )
    equal = {e: tx.episodes.with_equal_samples(e, made.plant) for e in episodes}
    came = tx.log.positions(made.plant, INGESTED, sorted(set().union(*equal.values())))
    before = {e for other in rejected for e in _episodes(other)}
    return [
        e
        for e, same in equal.items()
        if same & before or min(came.get(each, 0) for each in same) <= since
    ]


def _episodes(made: DecisionRecord) -> list[str]:
    document: Any = made.document
    episodes: list[str] = document["episodes"]
    return episodes
