"""Commands that manage webhooks, for admins."""

from __future__ import annotations

from typing import Annotated, Literal

from cyclopts import App, Parameter

from trueup_cli.exits import CALLS_SERVICE, exit_codes
from trueup_cli.options import DEFAULT_URL, Json, Url, connect
from trueup_cli.show import as_json, err, moment, say, table
from trueup_client.records import Webhook

app = App(
    name="webhook",
    help="Tell other services what happens.",
    help_epilogue=exit_codes(CALLS_SERVICE),
)


@app.command
def add(
    name: str,
    to: str,
    *events: Literal["episode", "alarm", "diagnosis", "decision", "promotion", "rollback"],
    form: Annotated[
        Literal["cloudevents", "slack"],
        Parameter(help="A CloudEvent, or a message for Slack and what takes the same"),
    ] = "cloudevents",
    project: Annotated[str | None, Parameter(help="Only what happens in this project")] = None,
    plant: Annotated[str | None, Parameter(help="Only what happens to this plant")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Declare a webhook and print the secret that signs its requests. It is never shown again.

    Parameters
    ----------
    name
        name of the webhook
    to
        address that events are sent to; its host must be one of TRUEUP_WEBHOOK_HOSTS
    events
        one or several of episode, alarm, diagnosis, decision, promotion, rollback
    """
    declared = connect(url).declare_webhook(name, to, list(events), form, project, plant)
    if as_json_:
        as_json(declared)
        return
    say("{}", declared["secret"])
    say(
        "[dim]{} tells {} of {}; the secret is not shown again: give it to the receiver now[/]",
        name,
        declared["host"],
        ", ".join(declared["events"]),
        to=err,
    )


@app.command(name="list")
def list_webhooks(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List webhooks, and how each is doing."""
    listed = list(connect(url).webhooks())
    if as_json_:
        as_json(listed)
        return
    rows = [
        (
            w["name"],
            w["host"],
            w["form"],
            ", ".join(w["events"]),
            w["plant"] or w["project"] or "all",
            w["sent"],
            _state(w),
        )
        for w in listed
    ]
    table("", ["name", "host", "form", "events", "of", "sent up to", "state"], rows)


def _state(webhook: Webhook) -> str:
    if webhook["state"] == "failing":
        return f"failing, again at {moment(webhook['due_at'] or '')}: {webhook['problem']}"
    if webhook["problem"] is not None and webhook["state"] == "stopped":
        return f"stopped: {webhook['problem']}"
    return webhook["state"]


@app.command(name="test")
def send_test(name: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Send a webhook a test event.

    Parameters
    ----------
    name
        name of the webhook
    """
    webhook = connect(url).test_webhook(name)
    as_json(webhook) if as_json_ else say("a test event is on its way to {}", webhook["host"])


@app.command
def resume(
    name: str,
    *,
    after: Annotated[
        int | None,
        Parameter(help="Send all that follows this entry of the log; default: where it stands"),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Try a webhook again now, also one that was stopped.

    Parameters
    ----------
    name
        name of the webhook
    """
    webhook = connect(url).resume_webhook(name, after)
    if as_json_:
        as_json(webhook)
    else:
        say("{} goes on behind entry {} of the log", name, webhook["sent"])


@app.command
def remove(name: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Remove a webhook for good; its name stays taken.

    Parameters
    ----------
    name
        name of the webhook
    """
    webhook = connect(url).remove_webhook(name)
    as_json(webhook) if as_json_ else say("{} is removed", webhook["name"])
