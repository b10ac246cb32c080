"""Routes of labels: what people call plants, episodes, versions and decisions."""

from __future__ import annotations

from typing import Annotated

from fastapi import Path, Query

from trueup_service.actions import find
from trueup_service.actions.label import Change, label, label_of, tag_as_kept
from trueup_service.http.dependencies import Limit, PlantName, RequestContext, RequestParts
from trueup_service.http.guard import guarded
from trueup_service.http.schemas.labels import Label, LabelChange
from trueup_service.http.schemas.wire import Page
from trueup_service.registry.label_record import Labelled
from trueup_service.registry.transaction import reading

router = guarded("/v1/plants/{plant}/labels", ["labels"])
Subject = Annotated[
    str,
    Path(
        pattern=r"^[0-9a-z_-]{1,64}$",
        description="The plant's name, or the digest of an episode, an artifact or a decision",
    ),
]


@router.get("", summary="List labels")
def list_labels(
    parts: RequestParts,
    plant: PlantName,
    kind: Annotated[Labelled | None, Query(description="Of what")] = None,
    tag: Annotated[str | None, Query(max_length=40, description="Only those with a tag")] = None,
    after: Annotated[str, Query(max_length=81)] = "",
    limit: Limit = 100,
) -> Page[Label]:
    """By kind and subject; `after` is `next` of the page before. What has no label is left out."""
    behind_kind, _, behind = after.partition("/")
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        wanted = None if tag is None else tag_as_kept(tag)
        labels = tx.labels.page(plant, kind, wanted, (behind_kind, behind), limit)
    more = f"{labels[-1].kind}/{labels[-1].subject}" if len(labels) == limit else None
    return Page[Label](items=[Label.model_validate(one) for one in labels], next=more)


@router.get("/{kind}/{subject}", summary="Get a label")
def get_label(parts: RequestParts, plant: PlantName, kind: Labelled, subject: Subject) -> Label:
    """An empty one where nobody has labelled it."""
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        return Label.model_validate(label_of(tx, plant, kind, subject))


@router.patch("/{kind}/{subject}", summary="Change a label")
def change_label(
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    kind: Labelled,
    subject: Subject,
    change: LabelChange,
) -> Label:
    """A name, tags and a note, by which people find it again. They change nothing that is judged,
    and the log keeps what they were."""
    asked = Change(change.name, change.tags, change.note, change.updated_at)
    made = parts.writer.run(lambda tx: label(tx, plant, kind, subject, asked, context))
    return Label.model_validate(made)
