"""Calls on labels: what people call plants, episodes, versions and decisions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from trueup_client.records import Label
from trueup_client.transport import Transport, url_path


class LabelCalls(Transport):
    """Labels."""

    def label(self, plant: str, kind: str, subject: str) -> Label:
        """Returns a label, an empty one where nobody has labelled it.

        `kind` is plant, episode, version or decision, and the subject the plant's name or the
        digest of the episode, artifact or decision.
        """
        return self._get(url_path("plants", plant, "labels", kind, subject))

    def labels(
        self, plant: str, kind: str | None = None, tag: str | None = None
    ) -> Iterator[Label]:
        """Yields the labels of a plant: of one kind or all, with a tag or with any."""
        return self._pages(url_path("plants", plant, "labels"), "after", kind=kind, tag=tag)

    def change_label(
        self,
        plant: str,
        kind: str,
        subject: str,
        *,
        name: str | None = None,
        tags: Sequence[str] | None = None,
        note: str | None = None,
        updated_at: str | None = None,
    ) -> Label:
        """Changes a label. What is None stays; empty text, or no tags, takes away what was there.

        Names and tags change nothing that is judged, and the log keeps what they were. With
        `updated_at`, as the label was read, a change is refused (`label-changed`) if somebody
        changed it since.
        """
        asked = {
            "name": name,
            "tags": None if tags is None else list(tags),
            "note": note,
            "updated_at": updated_at,
        }
        return self._connection.json(
            "PATCH",
            url_path("plants", plant, "labels", kind, subject),
            {field: value for field, value in asked.items() if value is not None},
        )
