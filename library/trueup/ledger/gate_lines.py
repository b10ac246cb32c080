"""Gate lines in the log: whether what each decision says of its gate is true, and what a reader of
the decision should know.

Entry by entry, from the log alone:

- a gate that names one that it follows names the one that was in force;
- what a decision says was known when its gate was declared, how often its episodes had been used,
  and of what its candidate and its episodes were selected, is what the log tells;
- a candidate that was rejected before, itself or under another digest, was promoted only on
  episodes that came in after its gate and after the rejection, or with somebody else's approval and
  a reason. Two tokens of one name are one person, and the approval of a revoked token counts for
  nothing.

Decisions from before this was recorded say nothing of it; what was known is remarked of them too. A
plant that was imported brought the log of another site, which is verified there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from trueup.gate.line import SHOWING, alike, disclosure_of, looser_than, selected
from trueup.ledger.audit import AuditEntry
from trueup.ledger.gate_history import DeclaredGate, GateHistory
from trueup.ledger.person import folded, name_of
from trueup.ledger.verification import Finding

WITHOUT_RESULT = ("failed", "cancelled")


@dataclass
class GateLineCheck:
    """Call it with every entry, in order: it returns what is false, and keeps in `remarks` what a
    reader should know."""

    remarks: list[str] = field(default_factory=list)
    _history: GateHistory = field(default_factory=GateHistory)
    _approvals: dict[str, list[AuditEntry]] = field(default_factory=dict)  # those with a reason
    # the name of each token by its prefix; None once it is revoked
    _token_names: dict[str, str | None] = field(default_factory=dict)
    _imported: set[str] = field(default_factory=set)
    _disclosing: set[str] = field(default_factory=set)  # decisions that say what was known

    def __call__(self, entry: AuditEntry) -> list[Finding]:
        """What of an entry is false."""
        if entry.kind == "token:issued":
            self._token_names[entry.subject] = str(entry.facts["name"])
        elif entry.kind == "token:revoked":
            self._token_names[entry.subject] = None
        check = CHECKS.get(entry.kind)
        if entry.plant is None or check is None:
            return []
        return [
            Finding(f"entry {entry.sequence}", what)
            for what in check(self, entry, entry.plant, entry.facts)
        ]

    def _registered(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        self._history.register(plant, facts.get("project"))
        return []

    def _plant_imported(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        self._imported.add(plant)
        return []

    def _ingested(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        self._history.ingest(entry, plant, facts)
        return []

    def _declared(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        document = facts["gate"]
        earlier = self._history.declare(
            plant, DeclaredGate(entry.subject, entry.sequence, document)
        )
        before = earlier[-1] if earlier else None
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
            self.remarks.append(f"{name} says of itself that it may accept the incumbent, {why}")
        if before is not None and self._history.is_judging(plant):
            less = looser_than([(gate.digest, gate.document) for gate in earlier], document)
            than = [f"looser than {each.gate[:12]}: {'; '.join(each.looser)}" for each in less]
            is_looser = ". It is ".join(than) or "nothing in it is looser"
            self.remarks.append(
                f"{name} took the place of {before.digest[:12]} after candidates had been "
                f"judged, or while they were, {why}; {is_looser}"
            )
        return []

    def _submitted(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        if facts["kind"] == "gate":
            self._history.submit_trial(entry.subject, plant, facts["request"])
        elif facts["kind"] in SHOWING:
            self._history.submit_comparison(entry.subject, plant, facts["request"])
        return []

    def _finished(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        if entry.subject not in self._history.pending:
            return []
        _, request = self._history.pending.pop(entry.subject)
        if facts["state"] in WITHOUT_RESULT:
            if facts["kind"] == "gate":
                self._history.give_back(request)
        elif facts["kind"] in SHOWING:
            self._history.finish_comparison(entry.subject, request, entry.sequence)
        return []

    def _cancelled(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        if facts.get("was") == "queued" and entry.subject in self._history.pending:
            _, request = self._history.pending.pop(entry.subject)
            if "gate" in request:
                self._history.give_back(request)
        return []

    def _decided(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        document = facts["decision"]
        gate = self._history.gate(plant, document["gate"])
        false = [] if gate is None else self._false_claims(entry, plant, facts, gate)
        self._history.decide(entry, plant, document)
        return false

    def _false_claims(
        self, entry: AuditEntry, plant: str, facts: Any, gate: DeclaredGate
    ) -> list[str]:
        """What a decision says of its gate, episodes and candidate, and the log does not."""
        document, decision = facts["decision"], f"decision {entry.subject[:12]}"
        known = self._history.known(plant, document, gate.at)
        if known["candidate"] or known["compared"] or alike(document):
            sentences = [disclosure_of(document["candidate"], known), *selected(document)]
            self.remarks.append(f"{decision} of plant {plant}: {' '.join(sentences)}")
        if "known" not in document:
            return []
        self._disclosing.add(entry.subject)
        if self._imported:
            return []  # what came from elsewhere may be known, and is not in this log
        false = []
        if document["known"] != known:
            false.append(
                f"what {decision} says was known when its gate was declared is not what the "
                "log tells"
            )
        expected = self._history.expected.get(str(facts.get("job")))
        if expected is None:
            return false
        if list(document["uses"]) != expected.uses:
            false.append(
                f"how often {decision} says its episodes were used is not what the log tells"
            )
        if "selection" in document:
            if not expected.agrees(document["selection"]):
                false.append(f"the selection that {decision} tells is not what the log tells")
            if not expected.allows(frozenset(document["figures"].get("beside", ()))):
                false.append(
                    f"the candidates scored beside that of {decision} are not those that the "
                    "log calls for"
                )
        return false

    def _approved(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        if "because" in facts:
            self._approvals.setdefault(entry.subject, []).append(entry)
        return []

    def _person(self, entry: AuditEntry) -> str | None:
        """Who did what an entry tells of; None where their token has been revoked since. Early
        entries may not name the token."""
        facts: Any = entry.facts
        name = self._token_names.get(str(facts.get("token")), name_of(entry.actor))
        return None if name is None else folded(name)

    def _moved(self, entry: AuditEntry, plant: str, facts: Any) -> list[str]:
        decision = facts.get("decision")
        if facts.get("move") != "promoted" or decision not in self._history.decisions:
            return []
        _, past = self._history.decisions[decision]
        rejections = self._history.rejections(plant, decision)
        if not rejections or self._history.is_fresh(plant, past, rejections):
            return []
        promotion = (
            f"candidate {past.candidate[:12]} of plant {plant} was promoted after decision "
            f"{rejections[0][1].decision[:12]} had rejected it, or a candidate that errs as it "
            "does"
        )
        nobody_else = {None, self._person(entry)}
        others = [
            approval.actor
            for approval in self._approvals.get(decision, [])
            if self._person(approval) not in nobody_else
        ]
        if others:
            self.remarks.append(
                f"{promotion}, with the approval of {' and '.join(others)} and a reason"
            )
            return []
        self.remarks.append(f"{promotion}, with nobody else's approval")
        return (
            [f"{promotion}, on episodes that were there before, with nobody else's approval"]
            if decision in self._disclosing
            else []
        )


CHECKS: Mapping[str, Callable[[GateLineCheck, AuditEntry, str, Any], list[str]]] = {
    "plant:registered": GateLineCheck._registered,
    "plant:imported": GateLineCheck._plant_imported,
    "episode:ingested": GateLineCheck._ingested,
    "gate:declared": GateLineCheck._declared,
    "job:submitted": GateLineCheck._submitted,
    "job:finished": GateLineCheck._finished,
    "job:cancelled": GateLineCheck._cancelled,
    "decision:made": GateLineCheck._decided,
    "decision:approved": GateLineCheck._approved,
    "pointer:moved": GateLineCheck._moved,
}
