"""What the log tells, up to an entry, of a registry's gates, episodes, trials and decisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from trueup.episode.role import HELD_OUT
from trueup.gate.line import (
    BESIDE,
    Past,
    known,
    past_of,
    rejects,
    selection,
    shown_candidates,
)
from trueup.ledger.audit import AuditEntry


@dataclass(frozen=True, slots=True)
class DeclaredGate:
    """A gate's document, and the sequence number of the entry that declared it."""

    digest: str
    at: int
    document: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Comparison:
    """A job that ended with entry `at`, and showed candidates' errors without any gate."""

    job: str
    candidates: tuple[str, ...]
    episodes: tuple[str, ...]
    at: int


@dataclass(frozen=True, slots=True)
class ExpectedTrial:
    """What the decision of a gate job must say, as the log told when the job was submitted.

    `uses` counts for each episode how often it was used. Of `selection`, the number of comparisons
    is an upper bound, because a comparison counts once it ends. Candidates that were `rejected`
    must be scored beside the job's own; those of jobs that are `waiting` may be, because a job
    counts once it ends.
    """

    uses: list[int]
    selection: Mapping[str, Any]
    rejected: frozenset[str]
    waiting: frozenset[str]

    def allows(self, beside: frozenset[str]) -> bool:
        """Whether these candidates may have been scored beside the job's own, and no others had to
        be."""
        return beside <= self.rejected | self.waiting and (
            len(beside) == BESIDE or self.rejected <= beside
        )

    def agrees(self, selection: Mapping[str, Any]) -> bool:
        """Whether a decision's selection is what the log tells."""
        uncounted = {"comparisons": 0}
        return {**selection, **uncounted} == {**self.selection, **uncounted} and bool(
            selection["comparisons"] <= self.selection["comparisons"]
        )


@dataclass
class GateHistory:
    """The entries up to now, as far as gates concern them. Methods named for an action take in an
    entry; the others answer from those taken in.

    A plant's episodes and jobs are kept by digest and id. `pending` are gate jobs and comparisons
    that have not ended, with their plant and request; `expected` what the decision of each gate job
    must say; `decisions` all decisions, each with the sequence number of its entry; `rejected` and
    `accepted` their documents.
    """

    pending: dict[str, tuple[str, Mapping[str, Any]]] = field(default_factory=dict)
    expected: dict[str, ExpectedTrial] = field(default_factory=dict)
    decisions: dict[str, tuple[int, Past]] = field(default_factory=dict)
    rejected: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    accepted: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    _projects: dict[str, str | None] = field(default_factory=dict)
    _gates: dict[str, list[DeclaredGate]] = field(default_factory=dict)
    # digests of decisions
    _by_candidate: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    _by_episode: dict[str, list[str]] = field(default_factory=dict)
    _by_plant: dict[str, list[str]] = field(default_factory=dict)
    # the entry that ingested a plant's episode, and the number of a plant's held-out episodes
    _ingested_at: dict[tuple[str, str], int] = field(default_factory=dict)
    _held_out: dict[str, int] = field(default_factory=dict)
    # digests of an episode's samples, and of the episodes that hold those samples
    _samples_of: dict[str, set[str]] = field(default_factory=dict)
    _episodes_with: dict[str, set[str]] = field(default_factory=dict)
    # comparisons on a plant's episode, ended or not; those that have ended
    _comparison_jobs: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    _comparisons: list[Comparison] = field(default_factory=list)
    # how often gate jobs have used an episode, and the candidates of a plant's gate jobs
    _uses: dict[str, int] = field(default_factory=dict)
    _tried: dict[str, set[str]] = field(default_factory=dict)

    def register(self, plant: str, project: str | None) -> None:
        """Take in a plant and the project that it belongs to."""
        self._projects[plant] = project

    def ingest(self, entry: AuditEntry, plant: str, facts: Mapping[str, Any]) -> None:
        """Take in an episode."""
        self._ingested_at.setdefault((plant, entry.subject), entry.sequence)
        self._held_out[plant] = self._held_out.get(plant, 0) + (facts.get("role") in HELD_OUT)
        if "samples_digest" in facts:
            samples = facts["samples_digest"]
            self._episodes_with.setdefault(samples, set()).add(entry.subject)
            self._samples_of.setdefault(entry.subject, set()).add(samples)

    def declare(self, plant: str, gate: DeclaredGate) -> list[DeclaredGate]:
        """Take in a gate; the plant's gates before it, in order."""
        gates = self._gates.setdefault(plant, [])
        before = list(gates)
        gates.append(gate)
        return before

    def submit_trial(self, job: str, plant: str, request: Mapping[str, Any]) -> None:
        """Take in a gate job, and what the log tells until now of its candidate and episodes."""
        episodes, own = list(request["episodes"]), {request["candidate"]}
        rejected = {
            self.decisions[d][1].candidate
            for d in self._by_plant.get(plant, ())
            if d in self.rejected
        }
        tried = self._tried.setdefault(plant, set())
        self.expected[job] = ExpectedTrial(
            [
                1 + sum(self._uses.get(equal, 0) for equal in self._with_equal_samples(e))
                for e in episodes
            ],
            self._selection(plant, request),
            frozenset(rejected - own),
            frozenset(tried - own),
        )
        tried |= own
        for episode in episodes:
            self._uses[episode] = self._uses.get(episode, 0) + 1
        self.pending[job] = plant, request

    def submit_comparison(self, job: str, plant: str, request: Mapping[str, Any]) -> None:
        """Take in a comparison."""
        self.pending[job] = plant, request
        for episode in request["episodes"]:
            self._comparison_jobs.setdefault((plant, episode), []).append(job)

    def finish_comparison(self, job: str, request: Mapping[str, Any], at: int) -> None:
        """Take in the end of a comparison, by the sequence number of its entry."""
        candidates = shown_candidates(request)
        self._comparisons.append(Comparison(job, candidates, tuple(request["episodes"]), at))

    def give_back(self, request: Mapping[str, Any]) -> None:
        """Take back the uses of a gate job's episodes, for it ended without a decision."""
        for episode in request["episodes"]:
            self._uses[episode] -= 1

    def decide(self, entry: AuditEntry, plant: str, document: Mapping[str, Any]) -> None:
        """Take in a decision."""
        past = past_of(entry.subject, plant, document)
        self.decisions[entry.subject] = entry.sequence, past
        self._by_candidate.setdefault((plant, past.candidate), []).append(entry.subject)
        self._by_plant.setdefault(plant, []).append(entry.subject)
        for episode in past.episodes:
            self._by_episode.setdefault(episode, []).append(entry.subject)
        (self.accepted if past.accepted else self.rejected)[entry.subject] = document

    def is_judging(self, plant: str) -> bool:
        """Whether a candidate of a plant has been judged, or a gate job is pending."""
        return plant in self._by_plant or any(
            of == plant and "gate" in request for of, request in self.pending.values()
        )

    def gate(self, plant: str, digest: str) -> DeclaredGate | None:
        """A plant's gate by digest, as it was last declared; None where it was not."""
        gates = reversed(self._gates.get(plant, []))
        return next((gate for gate in gates if gate.digest == digest), None)

    def known(self, plant: str, document: Mapping[str, Any], before: int) -> dict[str, Any]:
        """What was known of a decision's candidate and episodes before the entry numbered
        `before`."""
        candidate, episodes = document["candidate"], list(document["episodes"])
        digests = {
            *self._by_candidate.get((plant, candidate), ()),
            *(d for e in episodes for d in self._by_episode.get(e, ())),
        }
        project = self._projects.get(plant)
        made = sorted((self.decisions[d] for d in digests), key=lambda each: each[0])
        pasts = [p for at, p in made if at < before and self._projects.get(p.plant) == project]
        compared = [
            c.job
            for c in self._comparisons
            if c.at < before and candidate in c.candidates and set(c.episodes) & set(episodes)
        ]
        return known(plant, candidate, episodes, pasts, compared)

    def rejections(self, plant: str, decision: str) -> list[tuple[int, Past]]:
        """Rejections, in order, of an accepted decision's candidate, of one that errs as it does,
        or of its model under another digest; see `trueup.gate.line.rejects`."""
        document = self.accepted.get(decision)
        if document is None:
            return []
        near = {d for e in document["episodes"] for d in self._by_episode.get(e, ())}
        near.update(self._by_plant.get(plant, ()))
        scoring = self._scoring(plant, document["gate"])
        rejections = []
        for digest in near & self.rejected.keys():
            at, past = self.decisions[digest]
            other = self._scoring(past.plant, past.gate)
            same = scoring is not None and other == scoring
            if rejects(self.rejected[digest], document, same_scoring=same):
                rejections.append((at, past))
        return sorted(rejections, key=lambda each: each[0])

    def is_fresh(self, plant: str, past: Past, rejections: list[tuple[int, Past]]) -> bool:
        """Whether every episode of a decision was ingested after its gate was declared and after
        every rejection. An episode with the same samples counts as the same."""
        since = max(
            *(at for at, _ in rejections),
            *(g.at for g in self._gates.get(plant, []) if g.digest == past.gate),
            0,
        )
        judged = {e for _, rejection in rejections for e in rejection.episodes}
        for episode in past.episodes:
            equal = {
                e for e in self._with_equal_samples(episode) if (plant, e) in self._ingested_at
            }
            equal = equal or {episode}
            if equal & judged or min(self._ingested_at.get((plant, e), 0) for e in equal) <= since:
                return False
        return True

    def _with_equal_samples(self, episode: str) -> set[str]:
        """An episode and all others that hold the same samples."""
        samples = self._samples_of.get(episode, ())
        return {episode}.union(*(self._episodes_with[digest] for digest in samples))

    def _scoring(self, plant: str, gate: str) -> Any:
        declared = self.gate(plant, gate)
        return None if declared is None else declared.document["scoring"]

    def _selection(self, plant: str, request: Mapping[str, Any]) -> dict[str, Any]:
        """Of how many the candidate and the episodes of a trial are selected."""
        gate = self.gate(plant, request["gate"])
        since = 0 if gate is None else gate.at
        digests = {d for e in request["episodes"] for d in self._by_episode.get(e, ())}
        others = [
            past.accepted
            for at, past in (self.decisions[d] for d in digests)
            if at > since and past.plant == plant and past.candidate != request["candidate"]
        ]
        comparisons = {
            job for e in request["episodes"] for job in self._comparison_jobs.get((plant, e), ())
        }
        return selection(
            self._held_out.get(plant, 0), others.count(True), others.count(False), len(comparisons)
        )
