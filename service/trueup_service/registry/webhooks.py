"""Webhooks, and how far each has been sent the log. The log names what was declared; it does not
name the cursors, which hold URLs and secrets and move with every event."""

from __future__ import annotations

from typing import Any

from sqlalchemy import ColumnElement, or_, select, update

from trueup_service.registry import tables as t
from trueup_service.registry.audit_log import LOG_SIZE
from trueup_service.registry.records import WebhookCursor, WebhookRecord
from trueup_service.registry.repository import Repository
from trueup_service.registry.row_format import document_text


class Webhooks(Repository[WebhookRecord]):
    """Webhooks by name."""

    table, record = t.webhooks, WebhookRecord

    def get(self, name: str) -> WebhookRecord | None:
        """A webhook by its name, removed or not."""
        return self._by(name=name)

    def page(self, after: str, limit: int) -> list[WebhookRecord]:
        """Webhooks by name from behind one."""
        return self._page(t.webhooks.c.name, after, limit)

    def remove(self, name: str, now: str, actor: str) -> bool:
        """Mark a webhook as removed. Returns False where it is removed already."""
        return self._end_once(t.webhooks.c.name == name, "removed", now, actor)


_OPEN = (
    t.webhook_cursors.c.webhook == t.webhooks.c.name,
    t.webhooks.c.removed_at.is_(None),
    t.webhook_cursors.c.stopped_at.is_(None),
)


class WebhookCursors(Repository[WebhookCursor]):
    """Where each webhook stands."""

    table, record = t.webhook_cursors, WebhookCursor

    def get(self, webhook: str) -> WebhookCursor | None:
        """The cursor of a webhook."""
        return self._one(select(t.webhook_cursors).where(t.webhook_cursors.c.webhook == webhook))

    def has_any(self) -> bool:
        """Whether there is a webhook that is neither removed nor stopped."""
        query = select(t.webhook_cursors.c.webhook).where(*_OPEN).limit(1)
        return self._connection.scalar(query) is not None

    def behind(self, now: str) -> list[WebhookCursor]:
        """The cursors that have not reached the end of the log, are due, and of which no delivery
        is under way."""
        of = t.webhook_cursors.c
        return self._all(
            select(t.webhook_cursors).where(
                *_OPEN,
                of.entry.is_(None),
                or_(of.due_at.is_(None), of.due_at <= now),
                of.sent < LOG_SIZE,
            )
        )

    def under_way(self) -> list[WebhookCursor]:
        """The cursors of which a delivery is under way."""
        return self._all(
            select(t.webhook_cursors).where(*_OPEN, t.webhook_cursors.c.entry.is_not(None))
        )

    def advance(self, cursor: WebhookCursor, end: int) -> bool:
        """Move a cursor over entries that are of no interest, if it still stands where it was
        read. Returns whether it was moved."""
        return self._update(cursor.webhook, *_as_read(cursor), sent=end, sent_beyond=[])

    def begin(self, cursor: WebhookCursor, entry: str) -> bool:
        """Mark a delivery as under way, if the cursor still stands where it was read and neither
        stopped nor paused. Returns whether it was."""
        of = t.webhook_cursors.c
        return self._update(
            cursor.webhook,
            *_as_read(cursor),
            of.stopped_at.is_(None),
            of.due_at.is_(None) if cursor.due_at is None else of.due_at == cursor.due_at,
            entry=entry,
        )

    def note(self, webhook: str, under_way: str, read_at: int | None, **values: Any) -> bool:
        """Note what a delivery under way has done, if it still is and the cursor stands where the
        delivery read it (`read_at`, None for anywhere). Returns whether it was noted."""
        of = t.webhook_cursors.c
        where = () if read_at is None else (of.sent == read_at,)
        return self._update(webhook, of.entry == under_way, *where, **values)

    def resume(self, webhook: str, **values: Any) -> None:
        """Let a webhook be tried again at once. A delivery under way goes on from where the cursor
        stands then."""
        self._update(
            webhook,
            held={},
            attempts=0,
            failing_since=None,
            due_at=None,
            problem=None,
            stopped_at=None,
            **values,
        )

    def forget_target(self, webhook: str, now: str) -> None:
        """Forget the URL and the secret of a webhook, and its delivery under way."""
        self._update(webhook, url="", secret="", entry=None, stopped_at=now)

    def _update(self, webhook: str, *where: ColumnElement[bool], **values: Any) -> bool:
        for name in ("sent_beyond", "held"):
            if name in values:
                values[name] = document_text(values[name])
        of_webhook = t.webhook_cursors.c.webhook == webhook
        return self._gateway.update(update(t.webhook_cursors), of_webhook, *where, **values)


def _as_read(cursor: WebhookCursor) -> tuple[ColumnElement[bool], ...]:
    of = t.webhook_cursors.c
    return of.entry.is_(None), of.sent == cursor.sent
