"""The calls of trueup_client.calls.labels for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence

from trueup_client.calls.labels import LabelCalls
from trueup_client.pool import Pooled
from trueup_client.records import Label


class AsyncLabelCalls(Pooled):
    """Labels. For an event loop."""

    async def label(self, plant: str, kind: str, subject: str) -> Label:
        """Returns a label, an empty one where nobody has labelled it.

        `kind` is plant, episode, version or decision, and the subject the plant's name or the
        digest of the episode, artifact or decision.
        """
        return await self._pool.run(LabelCalls.label, plant, kind, subject)

    def labels(
        self, plant: str, kind: str | None = None, tag: str | None = None
    ) -> AsyncIterator[Label]:
        """Yields the labels of a plant: of one kind or all, with a tag or with any."""
        return self._pool.each(LabelCalls.labels, plant, kind, tag)

    async def change_label(
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
        return await self._pool.run(
            LabelCalls.change_label,
            plant,
            kind,
            subject,
            name=name,
            tags=tags,
            note=note,
            updated_at=updated_at,
        )
