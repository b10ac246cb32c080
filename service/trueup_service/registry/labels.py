"""Labels: what people call plants, episodes, versions and decisions."""

from __future__ import annotations

from collections.abc import Sequence

from orjson import loads
from sqlalchemy import ColumnElement, bindparam, select, tuple_, update

from trueup_service.registry import tables as t
from trueup_service.registry.audit_log import ESCAPE
from trueup_service.registry.label_record import LabelRecord
from trueup_service.registry.repository import Repository
from trueup_service.registry.row_format import document_text

_OF = t.labels.c
_SOME = select(t.labels).where(
    _OF.plant == bindparam("of_plant"),
    _OF.kind == bindparam("of_kind"),
    _OF.subject.in_(bindparam("subjects", expanding=True)),
)


class Labels(Repository[LabelRecord]):
    """Labels, one for each thing that has one."""

    table, record = t.labels, LabelRecord

    def get(self, plant: str, kind: str, subject: str) -> LabelRecord | None:
        """The label of something of a plant."""
        return self._by(plant=plant, kind=kind, subject=subject)

    def of(self, plant: str, kind: str, subjects: Sequence[str]) -> dict[str, LabelRecord]:
        """The labels of some things of one kind, by subject; without those that have none."""
        others = {"of_plant": plant, "of_kind": kind}
        rows = self._gateway.in_parts(_SOME, "subjects", subjects, others)
        return {r.subject: r for r in map(self._record, rows)}

    def names(self, plant: str, kind: str, subjects: Sequence[str]) -> dict[str, str]:
        """What some things of one kind are called, by subject; without those that have no name."""
        return {s: r.name for s, r in self.of(plant, kind, subjects).items() if r.name}

    def tags(self, plant: str, kind: str) -> list[str]:
        """Every tag that things of one kind have, in the order of the alphabet."""
        query = select(_OF.tags).where(_OF.plant == plant, _OF.kind == kind, _OF.tags != "[]")
        return sorted(
            {tag for tags in self._connection.scalars(query.distinct()) for tag in loads(tags)}
        )

    def of_plants(self, plants: Sequence[str]) -> dict[str, LabelRecord]:
        """The labels of some plants by name; without those that have none."""
        query = select(t.labels).where(_OF.kind == "plant", _OF.plant.in_(plants))
        return {r.plant: r for r in self._all(query)}

    def page(
        self, plant: str, kind: str | None, tag: str | None, after: tuple[str, str], limit: int
    ) -> list[LabelRecord]:
        """Labels of a plant in the order of kind and subject from behind one: of one kind or all,
        with a tag or with any."""
        key = tuple_(_OF.kind, _OF.subject)
        query = select(t.labels).where(_OF.plant == plant, key > after)
        query = query if kind is None else query.where(_OF.kind == kind)
        query = query if tag is None else query.where(has_tag(tag))
        return self._all(query.order_by(*key.clauses).limit(limit))

    def put(self, label: LabelRecord) -> None:
        """Store a label in the place of the one that was there."""
        this = (
            (_OF.plant == label.plant) & (_OF.kind == label.kind) & (_OF.subject == label.subject)
        )
        replaced = self._gateway.update(
            update(t.labels),
            this,
            name=label.name,
            tags=document_text(label.tags),
            note=label.note,
            updated_at=label.updated_at,
            updated_by=label.updated_by,
        )
        if replaced:
            self._gateway.note_changed(t.labels, this)
        else:
            self.add(label)


def has_tag(tag: str) -> ColumnElement[bool]:
    """The condition that a label has a tag, which holds no quotation mark."""
    return _OF.tags.contains(f'"{tag}"', autoescape=True, escape=ESCAPE)
