"""Webhooks, and how far each has been sent the log. The log names what was declared; it does not
name the cursors, which hold URLs and secrets and move with every event."""

from __future__ import annotations

from typing import Any

from sqlalchemy import ColumnElement, or_, select, update

from trueup_service.registry import tables as t
from trueup_service.registry.records import WebhookCursor, WebhookRecord
from trueup_service.registry.repository import Repository
from trueup_service.registry.row_format import document_text


class Webhooks(Repository[WebhookRecord]):
    """Webhooks by name."""

    table, record = t.webhooks, WebhookRecord

    def get(self, name: str) -> WebhookRecord | None:
        """A webhook by its name, removed or not."""
        return self._one(select(t.webhooks).where(t.webhooks.c.name == name))

    def page(self, after: str, limit: int) -> list[WebhookRecord]:
        """Webhooks by name from behind one."""
        return self._page(t.webhooks.c.name, after, limit)

    def remove(self, name: str, now: str, actor: str) -> bool:
        """Mark a webhook as removed. Returns False where it is removed already."""
        of_name = t.webhooks.c.name == name
        removed = self._gateway.update(
            update(t.webhooks),
            of_name,
            t.webhooks.c.removed_at.is_(None),
            removed_at=now,
            removed_by=actor,
        )
        if removed:
            self._gateway.note_changed(t.webhooks, of_name)
        return removed


_OPEN = (
    t.webhook_cursors.c.webhook == t.webhooks.c.name,
    t.webhooks.c.removed_at.is_(None),
    t.webhook_cursors.c.stopped_at.is_(None),
)
_SIZE = select(t.audit_head.c.size).where(t.audit_head.c.id == 1).scalar_subquery()


class WebhookCursors(Repository[WebhookCursor]):
    """Where each webhook stands."""

    table, record = t.webhook_cursors, WebhookCursor

    def get(self, webhook: str) -> WebhookCursor | None:
        """The cursor of a webhook."""
        return self._one(select(t.webhook_cursors).where(t.webhook_cursors.c.webhook == webhook))

    def behind(self, now: str) -> list[WebhookCursor]:
        """The cursors that have not reached the end of the log, are due, and of which no delivery
        is under way."""
        of = t.webhook_cursors.c
        return self._all(
            select(t.webhook_cursors).where(
                *_OPEN,
                of.entry.is_(None),
                or_(of.due_at.is_(None), of.due_at <= now),
                of.sent < _SIZE,
            )
        )

    def under_way(self) -> list[WebhookCursor]:
        """The cursors of which a delivery is under way."""
        return self._all(
            select(t.webhook_cursors).where(*_OPEN, t.webhook_cursors.c.entry.is_not(None))
        )

    def update(self, webhook: str, under_way: str | None, **values: Any) -> bool:
        """Change a cursor if this delivery is under way of it, None for none. Returns whether it
        was changed."""
        entry = t.webhook_cursors.c.entry
        return self._update(
            webhook, entry.is_(None) if under_way is None else entry == under_way, **values
        )

    def resume(self, webhook: str, **values: Any) -> None:
        """Let a webhook be tried again at once, whether a delivery is under way or not."""
        self._update(
            webhook,
            entry=None,
            attempts=0,
            failing_since=None,
            due_at=None,
            problem=None,
            stopped_at=None,
            **values,
        )

    def forget_target(self, webhook: str) -> None:
        """Forget the URL and the secret of a webhook, and its delivery under way."""
        self._update(webhook, url="", secret="", entry=None)

    def _update(self, webhook: str, *where: ColumnElement[bool], **values: Any) -> bool:
        if "sent_beyond" in values:
            values["sent_beyond"] = document_text(values["sent_beyond"])
        of_webhook = t.webhook_cursors.c.webhook == webhook
        return self._gateway.update(update(t.webhook_cursors), of_webhook, *where, **values)
