"""Calls on gates, and on the decisions that they reached."""

from __future__ import annotations

from collections.abc import Iterator

from trueup_client.records import Approval, Decision, Document, Envelope, Gate, GateInLine
from trueup_client.transport import Transport, url_path


class GateCalls(Transport):
    """Gates and decisions."""

    def declare_gate(self, plant: str, document: Document | None = None) -> Gate:
        """Declares a gate, before any candidate is scored by it.

        Without a document it is the gate in force, or the default where there is none. Once a
        candidate was judged, another gate names the one in force in `follows` and says why in
        `because`.
        """
        return self._post(url_path("plants", plant, "gates"), document)

    def gate_in_force(self, plant: str) -> GateInLine:
        """Returns the gate in force, and what is looser in it than in the one before."""
        return self._get(url_path("plants", plant, "gate"))

    def gate_in_line(self, plant: str, digest: str) -> GateInLine:
        """Returns a gate, whether it is in force, and what is looser than in the one before."""
        return self._get(url_path("plants", plant, "gates", digest, "line"))

    def gates(self, plant: str) -> Iterator[Gate]:
        """Yields every gate of a plant, by digest."""
        return self._pages(url_path("plants", plant, "gates"), "after")

    def gate(self, plant: str, digest: str) -> Gate:
        """Returns a gate by its digest."""
        return self._get(url_path("plants", plant, "gates", digest))

    def decisions(self, plant: str) -> Iterator[Decision]:
        """Yields the decisions on a plant's candidates, the newest first."""
        return self._pages(url_path("plants", plant, "decisions"), "before")

    def decision(self, plant: str, digest: str) -> Decision:
        """Returns a decision of one plant."""
        return self._get(url_path("plants", plant, "decisions", digest))

    def find_decision(self, digest: str) -> Decision:
        """Returns a decision by its digest alone, of whichever plant."""
        return self._get(url_path("decisions", digest))

    def approve(self, plant: str, decision: str, because: str | None = None) -> Approval:
        """Approves a decision, where a promotion takes two people.

        `because` is required if the candidate was rejected before.
        """
        body = None if because is None else {"because": because}
        return self._post(url_path("plants", plant, "decisions", decision, "approvals"), body)

    def decision_provenance(self, plant: str, digest: str) -> Envelope:
        """Returns a gate's verdict on a candidate: an in-toto statement in a signed envelope."""
        return self._get(url_path("plants", plant, "decisions", digest, "provenance"))
