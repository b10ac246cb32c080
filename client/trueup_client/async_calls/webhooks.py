"""The calls of trueup_client.calls.webhooks for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

from collections.abc import AsyncIterator

from trueup_client.calls.webhooks import WebhookCalls
from trueup_client.pool import Pooled
from trueup_client.records import DeclaredWebhook, Webhook


class AsyncWebhookCalls(Pooled):
    """Webhooks. For an event loop."""

    async def declare_webhook(
        self,
        name: str,
        url: str,
        events: list[str],
        form: str = "cloudevents",
        project: str | None = None,
        plant: str | None = None,
    ) -> DeclaredWebhook:
        """Declares a webhook. The answer's `secret` is shown this once.

        The request is sent once. If its answer is lost, remove the webhook and declare another.
        """
        return await self._pool.run(
            WebhookCalls.declare_webhook, name, url, events, form, project, plant
        )

    def webhooks(self) -> AsyncIterator[Webhook]:
        """Yields the webhooks, and how each is doing."""
        return self._pool.each(WebhookCalls.webhooks)

    async def webhook(self, name: str) -> Webhook:
        """Returns a webhook, and how it is doing."""
        return await self._pool.run(WebhookCalls.webhook, name)

    async def test_webhook(self, name: str) -> Webhook:
        """Sends a webhook a test event."""
        return await self._pool.run(WebhookCalls.test_webhook, name)

    async def resume_webhook(self, name: str, after: int | None = None) -> Webhook:
        """Tries a webhook again now, from where it stands or from behind an entry of the log."""
        return await self._pool.run(WebhookCalls.resume_webhook, name, after)

    async def remove_webhook(self, name: str) -> Webhook:
        """Removes a webhook for good."""
        return await self._pool.run(WebhookCalls.remove_webhook, name)
