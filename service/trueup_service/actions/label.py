"""Give something of a plant a name, tags and a note, by which people find it again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from trueup.canonical import Json
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.control_characters import without_control_characters
from trueup_service.errors import BadRequest, LabelChanged
from trueup_service.registry.label_record import Labelled, LabelRecord
from trueup_service.registry.transaction import ReadTransaction, Transaction

MOST_TAGS, MOST_OF_TAG, MOST_OF_NAME, MOST_OF_NOTE = 20, 40, 200, 10_000
REQUIRE: Mapping[Labelled, Callable[[ReadTransaction, str, str], object]] = {
    Labelled.EPISODE: find.episode,
    Labelled.VERSION: find.artifact,
    Labelled.DECISION: find.decision,
}


@dataclass(frozen=True, slots=True)
class Change:
    """What changes of a label; a field that is None stays as it is, and an empty text or list takes
    away what was there. `updated_at` is what the label had when it was read, None where nobody
    compares."""

    name: str | None = None
    tags: list[str] | None = None
    note: str | None = None
    updated_at: str | None = None


def label(
    tx: Transaction, plant: str, kind: Labelled, subject: str, change: Change, context: ActorContext
) -> LabelRecord:
    """Change the label of something, with its entry in the log, unless nothing differs. Raises
    NotFound, BadRequest, LabelChanged."""
    find.plant_digest(tx, plant)
    if kind is not Labelled.PLANT:
        REQUIRE[kind](tx, plant, subject)
    elif subject != plant:
        raise find.not_found("plant", subject)
    tx.plants.lock(plant)
    before = label_of(tx, plant, kind, subject)
    if change.updated_at is not None and change.updated_at != before.updated_at:
        raise LabelChanged(
            f"{before.updated_by} changed it at {before.updated_at}",
            updated_at=before.updated_at,
            updated_by=before.updated_by,
        )
    after = replace(
        before,
        name=before.name if change.name is None else _text(change.name),
        tags=before.tags if change.tags is None else _tags(change.tags),
        note=before.note if change.note is None else _text(change.note),
    )
    if after == before:
        return before
    made = replace(after, updated_at=context.now, updated_by=context.actor)
    tx.labels.put(made)
    facts: dict[str, Json] = {
        "kind": kind,
        "name": made.name,
        "tags": list(made.tags),
        "note": made.note,
    }
    tx.log.append(context, "label:changed", plant=plant, subject=subject, facts=facts)
    return made


def label_of(tx: ReadTransaction, plant: str, kind: Labelled, subject: str) -> LabelRecord:
    """The label of something, an empty one where it has none."""
    known = tx.labels.get(plant, kind, subject)
    return known or LabelRecord(plant, kind, subject, None, [], None, "", "")


def first_name(file: str | None, conditions: Json) -> str | None:
    """What an uploaded recording is called at first: as its condition `recording` says, else by its
    file."""
    said = conditions.get("recording") if isinstance(conditions, Mapping) else None
    name = str(said) if said else (file or "").replace("\\", "/").rsplit("/", 1)[-1]
    return _text(without_control_characters(name)[:MOST_OF_NAME])


def tag_as_kept(tag: str) -> str:
    """A tag as it is stored, and found: in lower case, with single spaces."""
    return " ".join(tag.lower().split())


def _text(text: str) -> str | None:
    return text.strip() or None


def _tags(tags: list[str]) -> list[str]:
    """Tags in lower case, each once, in their order. Raises BadRequest."""
    kept = list(dict.fromkeys(map(tag_as_kept, tags)))
    wrong = [t for t in kept if not t or len(t) > MOST_OF_TAG or set(t) & set(',"\\')]
    if wrong or len(kept) > MOST_TAGS:
        raise BadRequest(
            f"the tag {wrong[0]!r} cannot be used" if wrong else f"{len(kept)} tags are too many",
            hint=f"Give at most {MOST_TAGS} tags of 1 to {MOST_OF_TAG} characters, without commas, "
            "quotation marks and backslashes.",
            field="tags",
        )
    return kept
