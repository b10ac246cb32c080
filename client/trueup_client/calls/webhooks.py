"""Calls on webhooks, which are told of events."""

from __future__ import annotations

import json
from collections.abc import Iterator

from trueup_client.records import DeclaredWebhook, Webhook
from trueup_client.transport import Transport, url_path


class WebhookCalls(Transport):
    """Webhooks."""

    def declare_webhook(
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
        body = {
            "name": name,
            "url": url,
            "events": events,
            "form": form,
            "project": project,
            "plant": plant,
        }
        headers = {"Content-Type": "application/json"}
        return json.loads(
            self._connection.once("POST", url_path("webhooks"), json.dumps(body).encode(), headers)
        )

    def webhooks(self) -> Iterator[Webhook]:
        """Yields the webhooks, and how each is doing."""
        return self._pages(url_path("webhooks"), "after")

    def webhook(self, name: str) -> Webhook:
        """Returns a webhook, and how it is doing."""
        return self._get(url_path("webhooks", name))

    def test_webhook(self, name: str) -> Webhook:
        """Sends a webhook a test event."""
        return self._post(url_path("webhooks", name, "test"), None)

    def resume_webhook(self, name: str, after: int | None = None) -> Webhook:
        """Tries a webhook again now, from where it stands or from behind an entry of the log."""
        return self._post(url_path("webhooks", name, "resume"), {"after": after})

    def remove_webhook(self, name: str) -> Webhook:
        """Removes a webhook for good."""
        return self._post(url_path("webhooks", name, "remove"), None)
