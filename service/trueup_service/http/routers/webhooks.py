"""Routes of webhooks."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from fastapi import Path, Query

from trueup_service.actions import webhooks as actions
from trueup_service.http.dependencies import Limit, RequestContext, RequestParts
from trueup_service.http.guard import guarded
from trueup_service.http.schemas.webhooks import (
    DeclaredWebhook,
    NewWebhook,
    Resumption,
    Webhook,
)
from trueup_service.http.schemas.wire import NAME_PATTERN, Page, page
from trueup_service.registry.transaction import reading, writing
from trueup_service.webhook_targets import WebhookTargets

router = guarded("/v1/webhooks", ["webhooks"])

WebhookName = Annotated[str, Path(pattern=NAME_PATTERN, description="A webhook's name")]


@router.post("", status_code=201, summary="Declare a webhook")
def declare(parts: RequestParts, context: RequestContext, wanted: NewWebhook) -> DeclaredWebhook:
    """The response is the only one that has `secret`. The URL's host must be one of
    TRUEUP_WEBHOOK_HOSTS. The route takes no idempotency key, since a repeated response would have
    to keep the secret. Remove a webhook whose response did not arrive."""
    host = WebhookTargets.of(parts.settings).require_url(wanted.url)
    new = actions.NewWebhook(
        name=wanted.name,
        url=wanted.url,
        host=host,
        form=wanted.form,
        events=sorted(set(wanted.events)),
        project=wanted.project,
        plant=wanted.plant,
    )
    with writing(parts.database) as tx:
        declared, secret = actions.declare_webhook(tx, new, context)
    return DeclaredWebhook.model_validate({**asdict(declared), "secret": secret})


@router.get("", summary="List webhooks")
def list_webhooks(
    parts: RequestParts, after: Annotated[str, Query(max_length=63)] = "", limit: Limit = 100
) -> Page[Webhook]:
    with reading(parts.database) as tx:
        listed = actions.webhooks(tx, after, limit)
    return page(Webhook, listed, limit, "name")


@router.get("/{webhook}", summary="A webhook, and how it is doing")
def show(parts: RequestParts, webhook: WebhookName) -> Webhook:
    with reading(parts.database) as tx:
        return Webhook.model_validate(actions.webhook(tx, webhook))


@router.post("/{webhook}/test", summary="Send a webhook a test event")
def test(parts: RequestParts, context: RequestContext, webhook: WebhookName) -> Webhook:
    """It is sent behind what the webhook has not been told yet. `sent` says when it has arrived."""
    with writing(parts.database) as tx:
        return Webhook.model_validate(actions.test_webhook(tx, webhook, context))


@router.post("/{webhook}/resume", summary="Try a webhook again now")
def resume(
    parts: RequestParts, context: RequestContext, webhook: WebhookName, how: Resumption
) -> Webhook:
    """It goes on where it stands. With `after` it is sent all that follows that entry of the log:
    an earlier one sends again what it was told, a later one skips what it refuses."""
    with writing(parts.database) as tx:
        return Webhook.model_validate(actions.resume_webhook(tx, webhook, how.after, context))


@router.post("/{webhook}/remove", summary="Remove a webhook")
def remove(parts: RequestParts, context: RequestContext, webhook: WebhookName) -> Webhook:
    """A webhook is removed for good: its URL and secret are forgotten, and its name stays taken."""
    with writing(parts.database) as tx:
        return Webhook.model_validate(actions.remove_webhook(tx, webhook, context))
