"""Deliveries: what happened is sent to the webhooks that want to hear of it.

The audit log is the outbox: an event is there because what it tells of was committed, and stays
there. Each webhook has a cursor in the log. A worker that sees a webhook behind queues a delivery
in the job engine, in the transaction that marks it as under way, so that no two workers deliver to
one webhook.
- The events of a plant are sent in the order of the log, each once the one before was accepted.
  Those of different plants are sent side by side.
- An event is sent again until it is accepted. One that was accepted, though its worker died before
  that was noted, is sent twice, with the same id.
- A plant whose event is refused holds up the others only once WINDOW events wait behind it.
- After a failure the webhook is tried again, later each time; after `webhook_retry_s` without any
  success it is stopped. Nothing is lost: the log keeps it, and whoever resumes the webhook says
  where.
"""

from __future__ import annotations

import logging
import threading
import uuid
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from trueup.canonical import canonical_bytes, digest_of_bytes
from trueup_service.actions.webhooks import Form
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.events import (
    Event,
    EventName,
    cloud_event,
    event_id,
    event_of,
    kinds_of,
    slack_message,
)
from trueup_service.jobs import PartState
from trueup_service.registry.records import WebhookCursor, WebhookRecord
from trueup_service.registry.transaction import ReadTransaction, Transaction, reading, writing
from trueup_service.settings import Settings
from trueup_service.webhook_targets import WebhookTargets
from trueup_service.wiring import Parts
from trueup_worker.webhook_requests import NotDelivered, WebhookRequests

log = logging.getLogger("trueup.worker")

LOOK_S = 1.0  # between looks for webhooks that are behind
LOST_S = 30.0  # between looks for deliveries that the engine gave up on
WINDOW = 100  # entries of the log that one round reads
SIDE_BY_SIDE = 8  # plants
FIRST_PAUSE_S, LONGEST_PAUSE_S = 5.0, 3600.0  # between attempts; each is twice the one before
MOST_DOUBLINGS = 20
DELIVERER = "webhooks"  # the actor that stops a webhook
MEDIA_TYPES = {Form.CLOUDEVENTS: "application/cloudevents+json", Form.SLACK: "application/json"}


def run_deliveries(parts: Parts, stop: threading.Event) -> None:
    """Queues deliveries to webhooks that are behind, until `stop` is set."""
    looks = 0
    while not stop.wait(LOOK_S):
        try:
            queue_due(parts, datetime.now(UTC))
            if looks % round(LOST_S / LOOK_S) == 0:
                release_lost(parts)
            looks += 1
        except Exception:
            log.exception("webhooks that are behind could not be looked for")


def queue_due(parts: Parts, now: datetime) -> list[str]:
    """Queues a delivery to every webhook for which there are events and that is due. Returns the
    names of these webhooks."""
    with reading(parts.database) as tx:
        rounds = [_next_round(tx, cursor) for cursor in tx.webhook_cursors.behind(time_text(now))]
    queued = []
    for round_ in rounds:
        name = round_.webhook.name
        if not round_.events:
            with writing(parts.database) as tx:
                tx.webhook_cursors.update(name, None, sent=round_.end, sent_beyond=[])
            continue
        parts.queue.prepare()
        entry = f"{DELIVERER}.{name}.{uuid.uuid4().hex}"
        with writing(parts.database) as tx:
            if tx.webhook_cursors.update(name, None, entry=entry):
                parts.queue.enqueue_delivery(tx.connection, entry, name)
                queued.append(name)
    return queued


def release_lost(parts: Parts) -> None:
    """Lets deliveries be queued anew that the engine gave up on or does not know."""
    with reading(parts.database) as tx:
        under_way = {c.entry: c.webhook for c in tx.webhook_cursors.under_way() if c.entry}
    if not under_way:
        return
    known = parts.queue.parts(list(under_way))
    for entry, webhook in under_way.items():
        if entry not in known or known[entry].state is not PartState.UNDER_WAY:
            with writing(parts.database) as tx:
                tx.webhook_cursors.update(webhook, entry, entry=None)


def deliver(parts: Parts, entry: str, webhook: str) -> None:
    """Sends a webhook everything that it has not been told, until it is at the end of the log or a
    request fails."""
    while True:
        with reading(parts.database) as tx:
            cursor = tx.webhook_cursors.get(webhook)
            if cursor is None or cursor.entry != entry:
                return  # it was removed or resumed
            round_ = _next_round(tx, cursor)
        sent = round_.send(parts.settings)
        now = datetime.now(UTC)
        with writing(parts.database) as tx:
            if not _note(tx, round_, sent, entry, now, parts.settings.webhook_retry_s):
                return


@dataclass(slots=True)
class Sent:
    """What was accepted, and the failure that ended the round, if one did."""

    accepted: set[int] = field(default_factory=set)
    failure: NotDelivered | None = None


@dataclass(frozen=True, slots=True)
class Round:
    """The next events of a webhook, and the sequence up to which the log was read for them."""

    webhook: WebhookRecord
    cursor: WebhookCursor
    events: Sequence[Event]
    end: int
    log_name: str

    def send(self, settings: Settings) -> Sent:
        """Sends the events, those of a plant in order and different plants side by side."""
        sent, by_plant = Sent(), defaultdict[str | None, list[Event]](list)
        if not self.events:
            return sent
        if digest_of_bytes(self.cursor.url.encode()) != self.webhook.target_digest:
            sent.failure = NotDelivered("its URL is not the one that was declared", gone=True)
            return sent
        for event in self.events:
            by_plant[event.entry.plant].append(event)
        with (
            WebhookRequests(
                WebhookTargets.of(settings), self.cursor.url, self.cursor.secret
            ) as requests,
            ThreadPoolExecutor(min(SIDE_BY_SIDE, len(by_plant))) as threads,
        ):
            for _ in threads.map(
                lambda events: self._send_in_order(events, requests.post, settings, sent),
                by_plant.values(),
            ):
                pass
        return sent

    def _send_in_order(
        self,
        events: Sequence[Event],
        post: Callable[[str, str, bytes], None],
        settings: Settings,
        sent: Sent,
    ) -> None:
        form = Form(self.webhook.form)
        for event in events:
            if sent.failure is not None and (sent.failure.unreachable or sent.failure.gone):
                return
            document = (
                slack_message(event, settings.public_url)
                if form is Form.SLACK
                else cloud_event(event, self.log_name, settings.public_url)
            )
            try:
                post(
                    event_id(event.entry, self.log_name),
                    MEDIA_TYPES[form],
                    canonical_bytes(document),
                )
            except NotDelivered as error:
                sent.failure = error
                return
            sent.accepted.add(event.entry.sequence)


def _next_round(tx: ReadTransaction, cursor: WebhookCursor) -> Round:
    webhook = tx.webhooks.get(cursor.webhook)
    assert webhook is not None
    size, keys = tx.log.size(), tx.log.signing_keys()
    # a test is of no plant, so it is read beside the events of a plant
    entries = tx.log.entries_of_kinds(
        cursor.sent, WINDOW, kinds_of(webhook.events), plant=webhook.plant, project=webhook.project
    )
    tests = tx.log.entries_of_kinds(cursor.sent, WINDOW, kinds_of([EventName.TEST]))
    end = entries[-1].sequence if len(entries) == WINDOW else size
    end = min(end, tests[-1].sequence) if len(tests) == WINDOW else end
    wanted = [
        event
        for entry in sorted((*entries, *tests), key=lambda e: e.sequence)
        if entry.sequence <= end
        and entry.sequence not in cursor.sent_beyond
        and (event := event_of(entry)) is not None
        and _is_wanted(event, webhook)
    ]
    log_name = keys[-1].verifier.partition("+")[0] if keys else "trueup"
    return Round(webhook, cursor, wanted, end, log_name)


def _is_wanted(event: Event, webhook: WebhookRecord) -> bool:
    if event.name is EventName.TEST:
        return event.entry.subject == webhook.name
    return event.name in webhook.events


def _note(
    tx: Transaction, round_: Round, sent: Sent, entry: str, now: datetime, retry_s: float
) -> bool:
    """Notes what a round has sent. Returns whether the delivery goes on."""
    cursor, name = round_.cursor, round_.webhook.name
    missing = [e.entry.sequence for e in round_.events if e.entry.sequence not in sent.accepted]
    reached = missing[0] - 1 if missing else round_.end
    accepted = {*cursor.sent_beyond, *sent.accepted}
    moved = {"sent": reached, "sent_beyond": sorted(s for s in accepted if s > reached)}
    if sent.failure is None:
        goes_on = round_.end < tx.log.size()
        tx.webhook_cursors.update(
            name,
            entry,
            **moved,
            entry=entry if goes_on else None,
            attempts=0,
            failing_since=None,
            due_at=None,
            problem=None,
        )
        return goes_on
    return _note_failure(tx, round_, sent.failure, moved, entry, now, retry_s)


def _note_failure(
    tx: Transaction,
    round_: Round,
    failure: NotDelivered,
    moved: dict[str, Any],
    entry: str,
    now: datetime,
    retry_s: float,
) -> bool:
    cursor, name = round_.cursor, round_.webhook.name
    # an event that was accepted shows the receiver alive, though another one is refused
    since = cursor.failing_since if moved["sent"] == cursor.sent else None
    attempts = cursor.attempts + 1 if since else 1
    failing_since = since or time_text(now)
    doublings = min(attempts - 1, MOST_DOUBLINGS)
    pause_s = min(LONGEST_PAUSE_S, max(FIRST_PAUSE_S * 2**doublings, failure.retry_after_s))
    stops = failure.gone or time_text(now - timedelta(seconds=retry_s)) >= failing_since
    noted = tx.webhook_cursors.update(
        name,
        entry,
        **moved,
        entry=None,
        attempts=attempts,
        failing_since=failing_since,
        due_at=None if stops else time_text(now + timedelta(seconds=pause_s)),
        problem=failure.problem,
        stopped_at=time_text(now) if stops else None,
    )
    if noted and stops:
        tx.log.append(
            ActorContext(DELIVERER, time_text(now)),
            "webhook:stopped",
            plant=None,
            subject=name,
            facts={"problem": failure.problem, "sent": moved["sent"]},
        )
    log.log(
        logging.ERROR if stops else logging.WARNING,
        "a webhook was stopped" if stops else "a webhook failed",
        extra={"webhook": name, "problem": failure.problem, "attempts": attempts},
    )
    return False
