"""A plant's line of gates: which one is in force, and what was known when a gate was declared.

What came before what is told by the log's own order, not by clocks, which may be wrong. What was imported came before everything here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json
from trueup.gate.line import Past, alike, known, looser, looser_than, past_of, rejects, selection
from trueup_service.actions import find
from trueup_service.errors import GateSuperseded
from trueup_service.registry.records import NOTHING_CAME, DecisionRecord, GateRecord, JobState
from trueup_service.registry.store import Reader

DECLARED, DECIDED, INGESTED = "gate:declared", "decision:made", "episode:ingested"


@dataclass(frozen=True, slots=True)
class Place:
    """A gate's place in its line: the one before it, what is looser in it than in that one and in every one, whether it is in force."""

    gate: GateRecord
    before: GateRecord | None
    looser: list[str]
    looser_than: list[dict[str, Json]]
    in_force: bool


def place(reader: Reader, plant: str, digest: str | None = None) -> Place | None:
    """The place of a gate, or without a digest of the one in force; None where there is none."""
    line = reader.gate_line(plant)
    at = next((i for i, gate in reversed(list(enumerate(line))) if digest in (None, gate.digest)), None)
    if at is None:
        return None
    before = line[at - 1] if at else None
    less = [] if before is None else looser(before.document, line[at].document)
    than = looser_than([(gate.digest, gate.document) for gate in line[:at]], line[at].document)
    return Place(line[at], before, less, than, at == len(line) - 1)


def require_in_force(reader: Reader, plant: str, gate: GateRecord) -> None:
    """Raises GateSuperseded."""
    last = reader.gate_line(plant)[-1]
    if last.digest != gate.digest:
        raise GateSuperseded(
            f"gate {gate.digest[:12]} was superseded: {last.digest[:12]} is in force since {last.created_at}", in_force=last.digest
        )


def known_at(reader: Reader, plant: str, gate: GateRecord, candidate: str, episodes: Sequence[str]) -> dict[str, Json]:
    """What was known of a candidate and its held-out episodes when a gate was declared."""
    declared = reader.log_positions(plant, DECLARED, [gate.digest]).get(gate.digest, 0)
    made = reader.decisions_on(plant, candidate, episodes)
    return known(plant, candidate, episodes, _before(reader, made, gate, declared), _compared(reader, candidate, episodes, declared))


def selection_of(reader: Reader, plant: str, gate: GateRecord, candidate: str, episodes: Sequence[str]) -> dict[str, Json]:
    """Of what the candidate and the episodes of a trial are selected, now that it is asked for."""
    declared = reader.log_positions(plant, DECLARED, [gate.digest]).get(gate.digest, 0)
    others = [d for d in reader.decisions_on(plant, candidate, episodes) if d.plant == plant and d.candidate != candidate]
    at = reader.log_positions(plant, DECIDED, [d.digest for d in others])
    outcomes = [d.accepted for d in others if at.get(d.digest, 0) > declared]
    compared = [j for j in reader.jobs_reading(episodes, "compare") if j.plant == plant and j.state not in NOTHING_CAME]
    return selection(reader.held_out(plant), outcomes.count(True), outcomes.count(False), len(compared))


def _before(reader: Reader, made: Sequence[DecisionRecord], gate: GateRecord, declared: int) -> list[Past]:
    """Those of some decisions that were made before the gate was declared, in the order of the log."""
    at: dict[str, int] = {}
    for plant in {d.plant for d in made}:
        at |= reader.log_positions(plant, DECIDED, [d.digest for d in made if d.plant == plant])
    found = [d for d in made if at.get(d.digest, 0) < declared or (at.get(d.digest, 0) == declared == 0 and d.created_at < gate.created_at)]
    return [past_of(d.digest, d.plant, d.document) for d in sorted(found, key=lambda d: (at.get(d.digest, 0), d.created_at, d.digest))]


def _compared(reader: Reader, candidate: str, episodes: Sequence[str], declared: int) -> list[str]:
    """Comparisons that had shown the candidate's errors on these episodes when the gate was declared."""
    jobs = [
        j
        for j in reader.jobs_reading(episodes, "compare")
        if j.state == JobState.SUCCEEDED and candidate in (j.request["first"], j.request["second"])
    ]
    ended: dict[str, int] = {}
    for plant in {j.plant for j in jobs}:
        ended |= reader.log_positions(plant, "job:finished", [j.id for j in jobs])
    return [j.id for j in jobs if ended.get(j.id, declared) < declared]


def rejections(reader: Reader, made: DecisionRecord) -> list[DecisionRecord]:
    """Decisions, whenever they were made, that rejected the candidate of a decision: itself, or what errs as it does."""
    document: Any = made.document
    scoring = find.gate(reader, made.plant, made.gate).document["scoring"]
    return [
        other
        for other in reader.rejections_of(made.plant, [made.candidate, *alike(document)], document["episodes"])
        if rejects(other.document, document, same_scoring=find.gate(reader, other.plant, other.gate).document["scoring"] == scoring)
    ]


def stale(reader: Reader, made: DecisionRecord, rejected: Sequence[DecisionRecord]) -> list[str]:
    """The episodes of an accepted decision that did not come in after its gate was declared and after its candidate was rejected."""
    document: Any = made.document
    episodes: list[str] = document["episodes"]
    since = reader.log_positions(made.plant, DECLARED, [made.gate]).get(made.gate, 0)
    for other in rejected:
        since = max(since, reader.log_positions(other.plant, DECIDED, [other.digest]).get(other.digest, 0))
    twins = {e: reader.twins(e, made.plant) for e in episodes}
    came = reader.log_positions(made.plant, INGESTED, sorted({twin for each in twins.values() for twin in each}))
    before = {e for other in rejected for e in _episodes(other)}
    return [e for e, same in twins.items() if same & before or min(came.get(twin, 0) for twin in same) <= since]


def _episodes(made: DecisionRecord) -> list[str]:
    document: Any = made.document
    found: list[str] = document["episodes"]
    return found
