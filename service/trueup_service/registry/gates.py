"""Gates, and the update policies that name one."""

from __future__ import annotations

from sqlalchemy import func, select

from trueup_service.registry import tables as t
from trueup_service.registry.audit_log import AuditLog
from trueup_service.registry.records import GateRecord, PolicyRecord
from trueup_service.registry.repository import Repository, TableGateway


class Gates(Repository[GateRecord]):
    """Declared gates."""

    table, record = t.gates, GateRecord

    def __init__(self, gateway: TableGateway, log: AuditLog) -> None:
        super().__init__(gateway)
        self._log = log

    def get(self, plant: str, digest: str) -> GateRecord | None:
        """A gate of a plant by its digest."""
        return self._by(plant=plant, digest=digest)

    def page(self, plant: str, after: str, limit: int) -> list[GateRecord]:
        """Gates in the order of their digests from behind one."""
        return self._page(t.gates.c.digest, after, limit, t.gates.c.plant == plant)

    def in_order(self, plant: str) -> list[GateRecord]:
        """Every gate of a plant in the order in which the log declares them. Imported gates, which
        this log does not declare, come first, by their time."""
        gates = self._all(select(t.gates).where(t.gates.c.plant == plant))
        at = self._log.positions(plant, "gate:declared", [gate.digest for gate in gates])
        return sorted(gates, key=lambda g: (at.get(g.digest, 0), g.created_at, g.digest))


class Policies(Repository[PolicyRecord]):
    """Update policies. The last one of a plant is in force."""

    table, record = t.policies, PolicyRecord

    def in_force(self, plant: str) -> PolicyRecord | None:
        """The policy of a plant that is in force."""
        return self._last("sequence", plant=plant)

    def page(self, plant: str, after: int, limit: int) -> list[PolicyRecord]:
        """Every policy that a plant has had, in order, from behind one."""
        return self._page(t.policies.c.sequence, after, limit, t.policies.c.plant == plant)

    def all_in_force(self) -> list[PolicyRecord]:
        """The policy in force of every plant that has one."""
        last = (
            select(t.policies.c.plant, func.max(t.policies.c.sequence).label("sequence"))
            .group_by(t.policies.c.plant)
            .subquery()
        )
        query = select(t.policies).join(
            last, (t.policies.c.plant == last.c.plant) & (t.policies.c.sequence == last.c.sequence)
        )
        return self._all(query.order_by(t.policies.c.plant))
