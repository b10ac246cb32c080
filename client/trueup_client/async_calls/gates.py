"""The calls of trueup_client.calls.gates for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

from collections.abc import AsyncIterator

from trueup_client.calls.gates import GateCalls
from trueup_client.pool import Pooled
from trueup_client.records import Approval, Decision, Document, Envelope, Gate, GateInLine


class AsyncGateCalls(Pooled):
    """Gates and decisions. For an event loop."""

    async def declare_gate(self, plant: str, document: Document | None = None) -> Gate:
        """Declares a gate, before any candidate is scored by it.

        Without a document it is the gate in force, or the default where there is none. Once a
        candidate was judged, another gate names the one in force in `follows` and says why in
        `because`.
        """
        return await self._pool.run(GateCalls.declare_gate, plant, document)

    async def gate_in_force(self, plant: str) -> GateInLine:
        """Returns the gate in force, and what is looser in it than in the one before."""
        return await self._pool.run(GateCalls.gate_in_force, plant)

    async def gate_in_line(self, plant: str, digest: str) -> GateInLine:
        """Returns a gate, whether it is in force, and what is looser than in the one before."""
        return await self._pool.run(GateCalls.gate_in_line, plant, digest)

    def gates(self, plant: str) -> AsyncIterator[Gate]:
        """Yields every gate of a plant, by digest."""
        return self._pool.each(GateCalls.gates, plant)

    async def gate(self, plant: str, digest: str) -> Gate:
        """Returns a gate by its digest."""
        return await self._pool.run(GateCalls.gate, plant, digest)

    def decisions(self, plant: str) -> AsyncIterator[Decision]:
        """Yields the decisions on a plant's candidates, the newest first."""
        return self._pool.each(GateCalls.decisions, plant)

    async def decision(self, plant: str, digest: str) -> Decision:
        """Returns a decision of one plant."""
        return await self._pool.run(GateCalls.decision, plant, digest)

    async def find_decision(self, digest: str) -> Decision:
        """Returns a decision by its digest alone, of whichever plant."""
        return await self._pool.run(GateCalls.find_decision, digest)

    async def approve(self, plant: str, decision: str, because: str | None = None) -> Approval:
        """Approves a decision, where a promotion takes two people.

        `because` is required if the candidate was rejected before.
        """
        return await self._pool.run(GateCalls.approve, plant, decision, because)

    async def decision_provenance(self, plant: str, digest: str) -> Envelope:
        """Returns a gate's verdict on a candidate: an in-toto statement in a signed envelope."""
        return await self._pool.run(GateCalls.decision_provenance, plant, digest)
