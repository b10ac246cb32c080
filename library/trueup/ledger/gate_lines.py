"""Gate lines in the log: is what each decision tells of its gate true, and what should whoever
reads it know?

Entry by entry, from the log alone:

- a gate that names one that it follows names the one that was in force;
- what a decision says was known when its gate was declared, how often its episodes had been used,
  and of what its candidate and its episodes were selected, is what the log tells;
- a candidate that was rejected before, itself or under another digest, was promoted only on
  episodes that came in after its gate and after the rejection, or with somebody else's approval and
  a reason. Two tokens of one name are one person, and the approval of a revoked token counts for
  nothing.

Decisions of before this was written down tell nothing of it; what was known is told of them all the
same. A plant that was imported brought the log of another site, which is verified there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from trueup.episode.role import HELD_OUT
from trueup.gate.line import (
    BESIDE,
    Past,
    alike,
    disclosure_of,
    known,
    looser_than,
    past_of,
    rejects,
    selected,
    selection,
)
from trueup.ledger.audit import AuditEntry
from trueup.ledger.person import folded, name_of
from trueup.ledger.verification import Finding

NOTHING_CAME = ("failed", "cancelled")


@dataclass(frozen=True, slots=True)
class _Gate:
    digest: str
    at: int
    document: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class _Comparison:
    job: str
    candidates: tuple[str, str]
    episodes: tuple[str, ...]
    at: int


@dataclass(frozen=True, slots=True)
class _Expected:
    """What a gate job must have been told when it was asked for; of comparisons, which end when
    they end, at most so many.

    Candidates that were `rejected` must be scored beside its own, and those that `wait`, whose jobs
    end when they end, may be.
    """

    uses: list[int]
    selection: dict[str, Any]
    rejected: frozenset[str]
    wait: frozenset[str]

    def allows(self, beside: frozenset[str]) -> bool:
        """Whether these candidates may have been scored beside the job's own, and no others had to
        be."""
        return beside <= self.rejected | self.wait and (
            len(beside) == BESIDE or self.rejected <= beside
        )


@dataclass
class GateLines:
    """Looks at every entry, in order: finds what is not so, and keeps in `notes` what a reader
    should know."""

    notes: list[str] = field(default_factory=list)
    _lines: dict[str, list[_Gate]] = field(default_factory=dict)
    _projects: dict[str, str | None] = field(default_factory=dict)
    _past: dict[str, tuple[int, Past]] = field(
        default_factory=dict
    )  # every decision with its entry, in order
    _by_candidate: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    _by_episode: dict[str, list[str]] = field(default_factory=dict)
    _by_plant: dict[str, list[str]] = field(default_factory=dict)
    _came: dict[tuple[str, str], int] = field(
        default_factory=dict
    )  # the entry of each plant's episode
    _held_out: dict[str, int] = field(default_factory=dict)  # episodes of each plant
    _holds: dict[str, set[str]] = field(
        default_factory=dict
    )  # what each episode holds, by the digest of its samples
    _samples: dict[str, set[str]] = field(
        default_factory=dict
    )  # the digests of the episodes that hold the same samples
    _asked: dict[str, tuple[str, Mapping[str, Any]]] = field(
        default_factory=dict
    )  # what gate jobs and comparisons read, of which plant
    _compared: dict[tuple[str, str], list[str]] = field(
        default_factory=dict
    )  # comparisons of each plant's episode, ended or not
    _rejected: dict[str, Mapping[str, Any]] = field(default_factory=dict)  # documents of decisions
    _accepted: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    _used: dict[str, int] = field(default_factory=dict)
    _tried: dict[str, set[str]] = field(
        default_factory=dict
    )  # candidates of each plant's gate jobs
    _expected: dict[str, _Expected] = field(default_factory=dict)  # by job
    _comparisons: list[_Comparison] = field(default_factory=list)
    _approved: dict[str, list[AuditEntry]] = field(default_factory=dict)  # with a reason
    _names: dict[str, str | None] = field(
        default_factory=dict
    )  # the name of each token, by its prefix; None once it is revoked
    _imported: set[str] = field(default_factory=set)
    _tells: set[str] = field(default_factory=set)  # decisions that say what was known

    def __call__(self, entry: AuditEntry) -> list[Finding]:
        """What an entry says that is not so."""
        if entry.kind == "token:issued":
            self._names[entry.subject] = str(entry.facts["name"])
        elif entry.kind == "token:revoked":
            self._names[entry.subject] = None
        look = LOOKS.get(entry.kind)
        if entry.plant is None or look is None:
            return []
        return [
            Finding(f"entry {entry.sequence}", what)
            for what in look(self, entry, entry.plant, entry.facts)
        ]

    def _registered(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        self._projects[plant] = facts.get("project")
        return []

    def _brought(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        self._imported.add(plant)
        return []

    def _ingested(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        self._came.setdefault((plant, entry.subject), entry.sequence)
        self._held_out[plant] = self._held_out.get(plant, 0) + (facts.get("role") in HELD_OUT)
        if "samples_digest" in facts:
            self._samples.setdefault(facts["samples_digest"], set()).add(entry.subject)
            self._holds.setdefault(entry.subject, set()).add(facts["samples_digest"])
        return []

    def _twins(self, episode: str) -> set[str]:
        return {episode}.union(*(self._samples[held] for held in self._holds.get(episode, ())))

    def _declared(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        line, document = self._lines.setdefault(plant, []), facts["gate"]
        before = line[-1] if line else None
        line.append(_Gate(entry.subject, entry.sequence, document))
        follows = document.get("follows")
        if (
            follows is not None
            and plant not in self._imported
            and (before is None or before.digest != follows)
        ):
            return [
                (
                    f"gate {entry.subject[:12]} says that it follows {follows[:12]}, which "
                    "was not in force"
                )
            ]
        why = f"because “{document['because']}”" if "because" in document else "without a reason"
        name = f"gate {entry.subject[:12]} of plant {plant}"
        if document.get("vacuous"):
            self.notes.append(f"{name} says of itself that it may accept the incumbent, {why}")
        judging = any(of == plant and "gate" in asked for of, asked in self._asked.values())
        if before is not None and (judging or plant in self._by_plant):
            less = looser_than([(gate.digest, gate.document) for gate in line[:-1]], document)
            than = [f"looser than {each.gate[:12]}: {'; '.join(each.looser)}" for each in less]
            is_looser = ". It is ".join(than) or "nothing in it is looser"
            took = (
                f"{name} took the place of {before.digest[:12]} after candidates had been "
                f"judged, or while they were, {why}"
            )
            self.notes.append(f"{took}; {is_looser}")
        return []

    def _submitted(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        request = facts.get("request")
        if facts["kind"] == "gate":
            episodes = list(request["episodes"])
            uses = [1 + sum(self._used.get(twin, 0) for twin in self._twins(e)) for e in episodes]
            own = {request["candidate"]}
            refused = {
                self._past[d][1].candidate
                for d in self._by_plant.get(plant, ())
                if d in self._rejected
            }
            tried = self._tried.setdefault(plant, set())
            known = (
                self._selection(plant, request),
                frozenset(refused - own),
                frozenset(tried - own),
            )
            self._expected[entry.subject] = _Expected(uses, *known)
            tried |= own
            for episode in episodes:
                self._used[episode] = self._used.get(episode, 0) + 1
            self._asked[entry.subject] = plant, request
        elif facts["kind"] == "compare":
            self._asked[entry.subject] = plant, request
            for episode in request["episodes"]:
                self._compared.setdefault((plant, episode), []).append(entry.subject)
        return []

    def _selection(self, plant: str, request: Mapping[str, Any]) -> dict[str, Any]:
        """Of what the candidate and the episodes of a trial are selected, as the log tells until
        now."""
        since = next(
            (g.at for g in reversed(self._lines.get(plant, [])) if g.digest == request["gate"]), 0
        )
        on_them = (
            self._past[d]
            for d in {d for e in request["episodes"] for d in self._by_episode.get(e, ())}
        )
        others = [
            p.accepted
            for at, p in on_them
            if at > since and p.plant == plant and p.candidate != request["candidate"]
        ]
        compared = {job for e in request["episodes"] for job in self._compared.get((plant, e), ())}
        return selection(
            self._held_out.get(plant, 0), others.count(True), others.count(False), len(compared)
        )

    def _finished(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        if entry.subject not in self._asked:
            return []
        _, asked = self._asked.pop(entry.subject)
        if facts["state"] in NOTHING_CAME:
            if facts["kind"] == "gate":
                self._given_back(asked)
        elif facts["kind"] == "compare":
            both = str(asked["first"]), str(asked["second"])
            self._comparisons.append(
                _Comparison(entry.subject, both, tuple(asked["episodes"]), entry.sequence)
            )
        return []

    def _cancelled(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        if facts.get("was") == "queued" and entry.subject in self._asked:
            _, asked = self._asked.pop(entry.subject)
            if "gate" in asked:
                self._given_back(asked)
        return []

    def _given_back(self, asked: Mapping[str, Any]) -> None:
        for episode in asked["episodes"]:
            self._used[episode] -= 1

    def _decided(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        document = facts["decision"]
        gate = next(
            (g for g in reversed(self._lines.get(plant, [])) if g.digest == document["gate"]), None
        )
        found = [] if gate is None else self._hold(entry, plant, facts, gate)
        past = past_of(entry.subject, plant, document)
        self._past[entry.subject] = entry.sequence, past
        self._by_candidate.setdefault((plant, past.candidate), []).append(entry.subject)
        self._by_plant.setdefault(plant, []).append(entry.subject)
        for episode in past.episodes:
            self._by_episode.setdefault(episode, []).append(entry.subject)
        (self._accepted if past.accepted else self._rejected)[entry.subject] = document
        return found

    def _hold(self, entry: AuditEntry, plant: str, facts: Any, gate: _Gate) -> list[str]:
        """Hold what a decision tells of its gate against the log."""
        document = facts["decision"]
        expected = self._known(plant, document, gate.at)
        if expected["candidate"] or expected["compared"] or alike(document):
            told = " ".join([disclosure_of(document["candidate"], expected), *selected(document)])
            self.notes.append(f"decision {entry.subject[:12]} of plant {plant}: {told}")
        if "known" not in document:
            return []
        self._tells.add(entry.subject)
        if self._imported:
            return []  # what came from elsewhere may be known, and is not in this log
        found = []
        if document["known"] != expected:
            found.append(
                f"what decision {entry.subject[:12]} says was known when its gate was "
                "declared is not what the log tells"
            )
        asked = self._expected.get(str(facts.get("job")))
        if asked is not None and list(document["uses"]) != asked.uses:
            found.append(
                f"how often decision {entry.subject[:12]} says its episodes were used is not "
                "what the log tells"
            )
        if asked is not None and "selection" in document:
            told = document["selection"]
            if {**told, "comparisons": 0} != {**asked.selection, "comparisons": 0} or told[
                "comparisons"
            ] > asked.selection["comparisons"]:
                found.append(
                    f"the selection that decision {entry.subject[:12]} tells is not what the "
                    "log tells"
                )
            if not asked.allows(frozenset(document["figures"].get("beside", ()))):
                found.append(
                    f"the candidates scored beside that of decision {entry.subject[:12]} are "
                    "not those that the log calls for"
                )
        return found

    def _known(self, plant: str, document: Mapping[str, Any], before: int) -> dict[str, Any]:
        """What was known of a decision's candidate and episodes before an entry."""
        candidate, episodes = document["candidate"], list(document["episodes"])
        digests = {
            *self._by_candidate.get((plant, candidate), ()),
            *(d for e in episodes for d in self._by_episode.get(e, ())),
        }
        project = self._projects.get(plant)
        made = sorted((self._past[d] for d in digests), key=lambda p: p[0])
        pasts = [p for at, p in made if at < before and self._projects.get(p.plant) == project]
        compared = [
            c.job
            for c in self._comparisons
            if c.at < before and candidate in c.candidates and set(c.episodes) & set(episodes)
        ]
        return known(plant, candidate, episodes, pasts, compared)

    def _approves(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        if "because" in facts:
            self._approved.setdefault(entry.subject, []).append(entry)
        return []

    def _person(self, entry: AuditEntry) -> str | None:
        """Who did what an entry tells of; None where their token has been revoked since. Entries of
        before may not name the token."""
        facts: Any = entry.facts
        name = self._names.get(str(facts.get("token")), name_of(entry.actor))
        return None if name is None else folded(name)

    def _moved(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        decision = facts.get("decision")
        if facts.get("move") != "promoted" or decision not in self._past:
            return []
        _, past = self._past[decision]
        rejected = self._rejections(plant, decision)
        if not rejected or self._fresh(plant, past, rejected):
            return []
        refused = (
            f"decision {rejected[0][1].decision[:12]} had rejected it, or a candidate that "
            "errs as it does"
        )
        said = f"candidate {past.candidate[:12]} of plant {plant} was promoted after {refused}"
        nobody_else = {None, self._person(entry)}
        others = [
            approval.actor
            for approval in self._approved.get(decision, [])
            if self._person(approval) not in nobody_else
        ]
        if others:
            self.notes.append(f"{said}, with the approval of {' and '.join(others)} and a reason")
            return []
        self.notes.append(f"{said}, with nobody else's approval")
        return (
            [f"{said}, on episodes that were there before, with nobody else's approval"]
            if decision in self._tells
            else []
        )

    def _rejections(self, plant: str, decision: str) -> list[tuple[int, Past]]:
        """Rejections of a decision's candidate, of itself or of what errs as it does, in order;
        `trueup.gate.line.rejects`."""
        document = self._accepted.get(decision)
        if document is None:
            return []
        near = {d for e in document["episodes"] for d in self._by_episode.get(e, ())}
        near.update(self._by_plant.get(plant, ()))
        scoring = self._scoring(plant, document["gate"])
        found = []
        for rejected in near & self._rejected.keys():
            at, past = self._past[rejected]
            other = self._scoring(past.plant, past.gate)
            if rejects(
                self._rejected[rejected],
                document,
                same_scoring=scoring is not None and other == scoring,
            ):
                found.append((at, past))
        return sorted(found, key=lambda each: each[0])

    def _scoring(self, plant: str, gate: str) -> Any:
        return next(
            (
                g.document["scoring"]
                for g in reversed(self._lines.get(plant, []))
                if g.digest == gate
            ),
            None,
        )

    def _fresh(self, plant: str, past: Past, rejected: list[tuple[int, Past]]) -> bool:
        """Whether every episode of a decision came in after its gate was declared and after every
        rejection, in whatever bytes."""
        since = max(
            *(at for at, _ in rejected),
            *(g.at for g in self._lines.get(plant, []) if g.digest == past.gate),
            0,
        )
        judged = {e for _, p in rejected for e in p.episodes}
        for episode in past.episodes:
            same = {twin for twin in self._twins(episode) if (plant, twin) in self._came} or {
                episode
            }
            if same & judged or min(self._came.get((plant, twin), 0) for twin in same) <= since:
                return False
        return True


LOOKS: Mapping[str, Callable[[GateLines, AuditEntry, str, Any], list[str]]] = {
    "plant:registered": GateLines._registered,
    "plant:imported": GateLines._brought,
    "episode:ingested": GateLines._ingested,
    "gate:declared": GateLines._declared,
    "job:submitted": GateLines._submitted,
    "job:finished": GateLines._finished,
    "job:cancelled": GateLines._cancelled,
    "decision:made": GateLines._decided,
    "decision:approved": GateLines._approves,
    "pointer:moved": GateLines._moved,
}
