"""Declare webhooks, test them, remove them, and resume those that were stopped."""

from __future__ import annotations

import base64
import secrets
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from trueup.canonical import Json, digest_of_bytes
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.errors import BadRequest, Conflict
from trueup_service.events import TESTED
from trueup_service.registry.records import WebhookCursor, WebhookRecord
from trueup_service.registry.transaction import ReadTransaction, Transaction

SECRET_PREFIX, SECRET_BYTES = "whsec_", 32  # Standard Webhooks 1.0, "Signature scheme"


class Form(StrEnum):
    """How an event is written."""

    CLOUDEVENTS = "cloudevents"
    SLACK = "slack"


class WebhookState(StrEnum):
    """How a webhook is doing."""

    SENDING = "sending"
    FAILING = "failing"  # it is tried again
    STOPPED = "stopped"  # until somebody resumes it
    REMOVED = "removed"


@dataclass(frozen=True, slots=True)
class Webhook:
    """A webhook and how it is doing: the entry of the log up to which it was told everything, how
    many attempts failed since anything was accepted, the last failure, and when the next attempt is
    due."""

    name: str
    host: str
    form: str
    events: list[str]
    project: str | None
    plant: str | None
    created_at: str
    created_by: str
    removed_at: str | None
    removed_by: str | None
    state: WebhookState
    sent: int
    attempts: int
    problem: str | None
    failing_since: str | None
    due_at: str | None


@dataclass(frozen=True, slots=True)
class NewWebhook:
    """A webhook that is to be declared, for a URL that was checked."""

    name: str
    url: str
    host: str
    form: Form
    events: list[str]
    project: str | None
    plant: str | None


def declare_webhook(
    tx: Transaction, wanted: NewWebhook, context: ActorContext
) -> tuple[Webhook, str]:
    """Declare a webhook, which is told of what happens from now on. Returns it, and the secret
    under which its requests are signed. Raises Conflict, BadRequest, NotFound."""
    if wanted.project is not None and wanted.plant is not None:
        raise BadRequest("a webhook is of a project or of a plant", field="plant")
    if wanted.project is not None:
        find.project(tx, wanted.project)
    if wanted.plant is not None:
        find.plant(tx, wanted.plant)
    tx.lock_name(f"webhook {wanted.name}")
    if tx.webhooks.get(wanted.name) is not None:
        raise Conflict("there is or was a webhook of that name", hint="Choose another name.")
    record = WebhookRecord(
        name=wanted.name,
        host=wanted.host,
        target_digest=digest_of_bytes(wanted.url.encode()),
        form=wanted.form.value,
        events=wanted.events,
        project=wanted.project,
        plant=wanted.plant,
        created_at=context.now,
        created_by=context.actor,
    )
    secret = SECRET_PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()
    tx.webhooks.add(record)
    tx.webhook_cursors.add(
        WebhookCursor(record.name, wanted.url, secret, sent=tx.log.size(), sent_beyond=[])
    )
    facts: dict[str, Json] = {
        "host": record.host,
        "form": record.form,
        "events": list(record.events),
        "project": record.project,
        "plant": record.plant,
    }
    _log(tx, context, "webhook:declared", record.name, facts)
    return webhook(tx, record.name), secret


def test_webhook(tx: Transaction, name: str, context: ActorContext) -> Webhook:
    """Send a webhook an event that says that it is tested. Raises NotFound, Conflict."""
    _require_open(tx, name)
    _log(tx, context, TESTED, name, {})
    return webhook(tx, name)


def resume_webhook(tx: Transaction, name: str, after: int | None, context: ActorContext) -> Webhook:
    """Try a webhook again now: from where it stands, or with all from behind the entry `after` of
    the log. Raises NotFound, Conflict, BadRequest."""
    _require_open(tx, name)
    end = tx.log.size()
    if after is not None and after > end:
        raise BadRequest(f"the log has {end} entries", field="after")
    moved: dict[str, Any] = {} if after is None else {"sent": after, "sent_beyond": []}
    tx.webhook_cursors.resume(name, **moved)
    facts: dict[str, Json] = {} if after is None else {"after": after}
    _log(tx, context, "webhook:resumed", name, facts)
    return webhook(tx, name)


def remove_webhook(tx: Transaction, name: str, context: ActorContext) -> Webhook:
    """Remove a webhook for good, and forget its URL and secret. Raises NotFound, Conflict."""
    _require_not_removed(tx, name)
    tx.webhooks.remove(name, context.now, context.actor)
    tx.webhook_cursors.forget_target(name, context.now)
    _log(tx, context, "webhook:removed", name, {})
    return webhook(tx, name)


def webhook(tx: ReadTransaction, name: str) -> Webhook:
    """A webhook by its name. Raises NotFound."""
    return _joined(find.webhook(tx, name), tx.webhook_cursors.get(name))


def webhooks(tx: ReadTransaction, after: str, limit: int) -> list[Webhook]:
    """Webhooks by name from behind one."""
    return [
        _joined(record, tx.webhook_cursors.get(record.name))
        for record in tx.webhooks.page(after, limit)
    ]


def _joined(record: WebhookRecord, cursor: WebhookCursor | None) -> Webhook:
    """A webhook with its cursor. One that an archive brought has none, and is sent nothing."""
    at = cursor or WebhookCursor(record.name, "", "", 0, [], stopped_at=record.created_at)
    state = (
        WebhookState.REMOVED
        if record.removed_at is not None
        else WebhookState.STOPPED
        if at.stopped_at is not None
        else WebhookState.FAILING
        if at.problem is not None
        else WebhookState.SENDING
    )
    return Webhook(
        name=record.name,
        host=record.host,
        form=record.form,
        events=record.events,
        project=record.project,
        plant=record.plant,
        created_at=record.created_at,
        created_by=record.created_by,
        removed_at=record.removed_at,
        removed_by=record.removed_by,
        state=state,
        sent=at.sent,
        attempts=at.attempts,
        problem=at.problem,
        failing_since=at.failing_since,
        due_at=at.due_at or min((h.due_at for h in at.held_plants().values()), default=None),
    )


def _require_not_removed(tx: ReadTransaction, name: str) -> None:
    if find.webhook(tx, name).removed_at is not None:
        raise Conflict("the webhook was removed", hint="Declare another one.")


def _require_open(tx: ReadTransaction, name: str) -> None:
    _require_not_removed(tx, name)
    if tx.webhook_cursors.get(name) is None:
        raise Conflict(
            "the webhook came with an archive, without its URL", hint="Declare another one here."
        )


def _log(
    tx: Transaction, context: ActorContext, kind: str, name: str, facts: dict[str, Json]
) -> None:
    tx.log.append(context, kind, plant=None, subject=name, facts=facts)
