"""Deliveries: what happened is sent to the webhooks that want to hear of it.

The audit log is the outbox: an event is there because what it tells of was committed, and stays
there. Each webhook has a cursor in the log. A worker that sees a webhook behind queues a delivery
in the job engine, in the transaction that marks it as under way, so that no two workers deliver to
one webhook.
- The events of a plant are sent in the order of the log, each once the one before was accepted.
  Those of different plants are sent side by side.
- An event is sent again until it is accepted. One that was accepted, though its worker died before
  that was noted, is sent twice, with the same id.
- A plant whose event is refused waits by itself, longer each time. It holds up the others only once
  WINDOW entries wait behind it.
- A receiver that cannot be reached, or asks for patience (429, 503), is left alone as a whole,
  longer each time. After `webhook_retry_s` without any accepted event a webhook is stopped. Nothing
  is lost: the log keeps it, and whoever resumes the webhook says where.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from trueup.canonical import canonical_bytes, digest_of_bytes
from trueup_service.actions.webhooks import Form
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.errors import WebhookRefused
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
from trueup_service.registry.records import HeldPlant, WebhookCursor, WebhookRecord
from trueup_service.registry.transaction import ReadTransaction, Transaction, reading, writing
from trueup_service.settings import Settings
from trueup_service.webhook_targets import WebhookTargets
from trueup_service.wiring import Parts
from trueup_worker.webhook_requests import NotDelivered, WebhookRequests

log = logging.getLogger("trueup.worker")

LOOK_S = 1.0  # between looks for webhooks that are behind
LOOK_FOR_ANY_S = 3.0  # where there is no webhook, since a look is most of what an idle worker takes
LOST_S = 30.0  # between looks for deliveries that the engine gave up on
WINDOW = 100  # entries of the log that one round reads
ROUNDS = 10  # of one delivery; then other webhooks have their turn
SIDE_BY_SIDE = 8  # plants
FIRST_PAUSE_S, LONGEST_PAUSE_S = 5.0, 3600.0  # between attempts; each is twice the one before
MOST_DOUBLINGS = 20
DELIVERER = "webhooks"  # the actor that stops a webhook
MEDIA_TYPES = {Form.CLOUDEVENTS: "application/cloudevents+json", Form.SLACK: "application/json"}


def run_deliveries(parts: Parts, stop: threading.Event) -> None:
    """Queues deliveries to webhooks that are behind, until `stop` is set."""
    pause_s, lost_at = LOOK_S, 0.0
    while not stop.wait(pause_s):
        try:
            has_any = _has_any(parts)
            pause_s = LOOK_S if has_any else LOOK_FOR_ANY_S
            if has_any:
                queue_due(parts, datetime.now(UTC))
            if has_any and time.monotonic() - lost_at > LOST_S:
                release_lost(parts)
                lost_at = time.monotonic()
        except Exception:
            log.exception("webhooks that are behind could not be looked for")


def _has_any(parts: Parts) -> bool:
    with reading(parts.database) as tx:
        return tx.webhook_cursors.has_any()


def queue_due(parts: Parts, now: datetime) -> list[str]:
    """Queues a delivery to every webhook for which there are events and that is due. Returns the
    names of these webhooks."""
    with reading(parts.database) as tx:
        behind = tx.webhook_cursors.behind(time_text(now))
        rounds = [_next_round(tx, cursor, time_text(now)) for cursor in behind]
    queued = []
    for round_ in rounds:
        if not round_.missing:
            with writing(parts.database) as tx:
                tx.webhook_cursors.advance(round_.cursor, round_.end)
        elif round_.events:
            parts.queue.prepare()
            name = round_.webhook.name
            entry = f"{DELIVERER}.{name}.{uuid.uuid4().hex}"
            with writing(parts.database) as tx:
                if tx.webhook_cursors.begin(round_.cursor, entry):
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
                tx.webhook_cursors.note(webhook, entry, None, entry=None)


def deliver(parts: Parts, entry: str, webhook: str) -> None:
    """Sends a webhook what it has not been told, until it is at the end of the log, nothing more
    can be sent now, or it was others' turn."""
    for number in range(1, ROUNDS + 1):
        with reading(parts.database) as tx:
            cursor = tx.webhook_cursors.get(webhook)
            if cursor is None or cursor.entry != entry:
                return  # it was removed
            round_ = _next_round(tx, cursor, time_text(datetime.now(UTC)))
        if round_.missing and not round_.events:  # all that is left waits by itself
            with writing(parts.database) as tx:
                tx.webhook_cursors.note(webhook, entry, None, entry=None)
            return
        sent = round_.send(parts.settings)
        with writing(parts.database) as tx:
            noted = Noted.of(round_, sent, datetime.now(UTC), parts.settings.webhook_retry_s)
            goes_on = noted.can_go_on and number < ROUNDS and round_.end < tx.log.size()
            if not noted.write(tx, round_, entry if goes_on else None):
                continue  # it was resumed meanwhile: from where it stands now
        if not goes_on:
            return


@dataclass(slots=True)
class Sent:
    """What was accepted, the refusals by plant, and the failure of the receiver as a whole."""

    accepted: set[int] = field(default_factory=set)
    refusals: dict[str, NotDelivered] = field(default_factory=dict)
    failure: NotDelivered | None = None

    def fail(self, plant: str, error: NotDelivered) -> None:
        """Note a failure: of the receiver, of which the gravest counts, or of a plant."""
        if not error.is_of_receiver:
            self.refusals[plant] = error
        elif self.failure is None or error.gone:
            self.failure = error


@dataclass(frozen=True, slots=True)
class Round:
    """The next events of a webhook: those that are missing, those among them that may be sent now,
    and the sequence up to which the log was read for them."""

    webhook: WebhookRecord
    cursor: WebhookCursor
    missing: Sequence[Event]
    events: Sequence[Event]
    end: int
    log_name: str

    def send(self, settings: Settings) -> Sent:
        """Sends the events, those of a plant in order and different plants side by side."""
        sent, by_plant = Sent(), defaultdict[str, list[Event]](list)
        for event in self.events:
            by_plant[event.entry.plant or ""].append(event)
        if not by_plant:
            return sent
        targets = WebhookTargets.of(settings)
        try:
            targets.require_url(self.cursor.url)
        except WebhookRefused as error:
            sent.failure = NotDelivered(error.message, is_of_receiver=True)
            return sent
        if digest_of_bytes(self.cursor.url.encode()) != self.webhook.target_digest:
            sent.failure = NotDelivered("its URL is not the one that was declared", gone=True)
            return sent
        with (
            WebhookRequests(targets, self.cursor.url, self.cursor.secret) as requests,
            ThreadPoolExecutor(min(SIDE_BY_SIDE, len(by_plant))) as threads,
        ):
            for _ in threads.map(
                lambda plant: self._send_in_order(
                    plant, by_plant[plant], requests.post, settings, sent
                ),
                by_plant,
            ):
                pass
        return sent

    def _send_in_order(
        self,
        plant: str,
        events: Sequence[Event],
        post: Callable[[str, str, bytes], None],
        settings: Settings,
        sent: Sent,
    ) -> None:
        form = Form(self.webhook.form)
        for event in events:
            if sent.failure is not None:
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
                sent.fail(plant, error)
                return
            sent.accepted.add(event.entry.sequence)


def _next_round(tx: ReadTransaction, cursor: WebhookCursor, now: str) -> Round:
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
    missing = [
        event
        for entry in sorted((*entries, *tests), key=lambda e: e.sequence)
        if entry.sequence <= end
        and entry.sequence not in cursor.sent_beyond
        and (event := event_of(entry)) is not None
        and _is_wanted(event, webhook)
    ]
    waiting = {plant for plant, held in cursor.held_plants().items() if held.due_at > now}
    events = [event for event in missing if (event.entry.plant or "") not in waiting]
    log_name = keys[-1].verifier.partition("+")[0] if keys else "trueup"
    return Round(webhook, cursor, missing, events, end, log_name)


def _is_wanted(event: Event, webhook: WebhookRecord) -> bool:
    if event.name is EventName.TEST:
        return event.entry.subject == webhook.name
    return event.name in webhook.events


@dataclass(frozen=True, slots=True)
class Noted:
    """What becomes of a cursor after a round: its new values, and the failure that stops the
    webhook, if one does."""

    values: Mapping[str, Any]
    stops: NotDelivered | None
    can_go_on: bool

    @staticmethod
    def of(round_: Round, sent: Sent, now: datetime, retry_s: float) -> Noted:
        """The outcome of a round that ended now."""
        cursor = round_.cursor
        held = _held(round_, sent, now)
        failure = sent.failure or next(iter(sent.refusals.values()), None)
        # whoever accepts anything is alive, though something else is refused
        is_alive = failure is None or (bool(sent.accepted) and sent.failure is None)
        since = None if sent.accepted else cursor.failing_since
        failing_since = None if is_alive else since or time_text(now)
        attempts = 0 if is_alive else 1 + (cursor.attempts if since else 0)
        is_spent = (
            failing_since is not None
            and time_text(now - timedelta(seconds=retry_s)) >= failing_since
        )
        stops = failure if failure is not None and (failure.gone or is_spent) else None
        is_paused = sent.failure is not None and stops is None
        pause_s = _pause_s(attempts, sent.failure) if sent.failure is not None else 0.0
        missing = [
            e.entry.sequence for e in round_.missing if e.entry.sequence not in sent.accepted
        ]
        reached = missing[0] - 1 if missing else round_.end
        beyond = {*cursor.sent_beyond, *sent.accepted}
        values = {
            "sent": reached,
            "sent_beyond": sorted(s for s in beyond if s > reached),
            "held": {plant: asdict(of) for plant, of in held.items()},
            "attempts": attempts,
            "failing_since": failing_since,
            "due_at": time_text(now + timedelta(seconds=pause_s)) if is_paused else None,
            "problem": failure.problem if failure else (cursor.problem if held else None),
            "stopped_at": time_text(now) if stops else None,
        }
        return Noted(values, stops, can_go_on=sent.failure is None and stops is None)

    def write(self, tx: Transaction, round_: Round, entry: str | None) -> bool:
        """Notes it, with the delivery that goes on, and logs that the webhook was stopped. Returns
        False, and changes nothing, where the cursor was moved meanwhile."""
        name = round_.webhook.name
        assert round_.cursor.entry is not None
        noted = tx.webhook_cursors.note(
            name, round_.cursor.entry, round_.cursor.sent, **self.values, entry=entry
        )
        problem = self.values["problem"]
        if noted and self.stops is not None:
            tx.log.append(
                ActorContext(DELIVERER, self.values["stopped_at"]),
                "webhook:stopped",
                plant=None,
                subject=name,
                facts={"because": self.stops.reason, "sent": self.values["sent"]},
            )
            log.error("a webhook was stopped", extra={"webhook": name, "problem": problem})
        elif noted and problem is not None:
            log.warning("a webhook failed", extra={"webhook": name, "problem": problem})
        return noted


def _held(round_: Round, sent: Sent, now: datetime) -> dict[str, HeldPlant]:
    """The plants that wait by themselves after a round."""
    alive = {e.entry.plant or "" for e in round_.events if e.entry.sequence in sent.accepted}
    before = round_.cursor.held_plants()
    held = {plant: of for plant, of in before.items() if plant not in alive}
    for plant, refusal in sent.refusals.items():
        attempts = held[plant].attempts + 1 if plant in held else 1
        due = now + timedelta(seconds=_pause_s(attempts, refusal))
        held[plant] = HeldPlant(attempts, time_text(due))
    return held


def _pause_s(attempts: int, failure: NotDelivered) -> float:
    doubled_s = FIRST_PAUSE_S * 2.0 ** min(attempts - 1, MOST_DOUBLINGS)
    return min(LONGEST_PAUSE_S, max(doubled_s, failure.retry_after_s))
