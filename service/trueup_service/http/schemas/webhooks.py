"""Webhooks on the wire."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from trueup_service.actions.webhooks import Form, WebhookState
from trueup_service.http.schemas.wire import FromRecord, Name, RequestBody, Time

# every event but the test, which is not selected
EventWord = Literal["episode", "alarm", "diagnosis", "decision", "promotion", "rollback"]


class NewWebhook(RequestBody):
    """A new webhook, which is told of what happens from now on: of one project or plant, or of all
    where both are null."""

    name: Name
    url: str = Field(
        min_length=1, max_length=2000, description="Where events are sent to; it is not shown again"
    )
    events: list[EventWord] = Field(min_length=1, max_length=6)
    form: Form = Field(Form.CLOUDEVENTS, description="A CloudEvent in JSON, or a message for Slack")
    project: Name | None = None
    plant: Name | None = None


class Webhook(FromRecord):
    """A webhook, without its URL and secret, and how it is doing."""

    name: str
    host: str
    form: Form
    events: list[EventWord]
    project: str | None
    plant: str | None
    created_at: Time
    created_by: str
    removed_at: Time | None
    removed_by: str | None
    state: WebhookState = Field(
        description="`failing` is tried again; `stopped` until somebody resumes it"
    )
    sent: int = Field(description="Sequence of the log up to which it was told everything")
    attempts: int = Field(description="Attempts in a row that failed")
    problem: str | None = Field(description="Why the last attempt failed")
    failing_since: Time | None
    due_at: Time | None = Field(description="When it is tried again")


class DeclaredWebhook(Webhook):
    """A webhook that was declared now, with its secret."""

    secret: str = Field(
        description="Key of the signatures (Standard Webhooks); it is shown this once"
    )


class Resumption(RequestBody):
    """How a webhook goes on."""

    after: Annotated[int, Field(ge=0)] | None = Field(
        None, description="Send again, or from now on, what follows this entry of the log"
    )
