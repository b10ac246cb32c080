"""Deliveries of events, on both storages: when they are queued, what they note, and when they give
up."""

import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from tests.support.made import plant_document
from tests.support.receiver import receiving
from tests.support.storage import Storage
from trueup_service.actions.webhooks import (
    Form,
    NewWebhook,
    declare_webhook,
    remove_webhook,
    resume_webhook,
    webhook,
)
from trueup_service.actor_context import ActorContext
from trueup_service.errors import Conflict
from trueup_service.registry.records import PlantRecord
from trueup_service.registry.transaction import reading, writing
from trueup_service.settings import Settings
from trueup_worker import deliveries
from trueup_worker.deliveries import deliver, queue_due, release_lost
from trueup_worker.sleeping import has_work, sleep_until_work

NOW = "2026-01-01T00:00:00.000000Z"
CONTEXT = ActorContext("tester", NOW)
EPISODE = {"role": "adaptation", "size_bytes": 1, "conditions": {}}


@pytest.fixture
def receiver():
    with receiving() as running:
        yield running


@pytest.fixture
def parts(storage, receiver):
    allowed = {"TRUEUP_WEBHOOK_HOSTS": "127.0.0.1", "TRUEUP_WEBHOOK_PRIVATE_RANGES": "127.0.0.1/32"}
    parts = Storage(storage.name, storage.environment | allowed).build()
    parts.queue.prepare()
    with writing(parts.database) as tx:
        for plant in ("a", "b"):
            tx.plants.add(PlantRecord(plant, "0" * 64, plant_document(), NOW, "tester", None))
            tx.log.append(CONTEXT, "plant:registered", plant=plant, subject=plant, facts={})
        wanted = NewWebhook(
            "hook", receiver.url, "127.0.0.1", Form.CLOUDEVENTS, ["episode"], None, None
        )
        declare_webhook(tx, wanted, CONTEXT)
    yield parts
    parts.close()


def happen(parts, *plants, kind="episode:ingested"):
    with writing(parts.database) as tx:
        for number, plant in enumerate(plants):
            tx.log.append(CONTEXT, kind, plant=plant, subject=f"{number}", facts=EPISODE)


def shown(parts):
    with reading(parts.database) as tx:
        return webhook(tx, "hook"), tx.webhook_cursors.get("hook"), tx.log.size()


def run_due(parts, now=None):
    """Queues what is due and delivers it here, as a worker would."""
    queued = queue_due(parts, now or datetime.now(UTC))
    for name in queued:
        with reading(parts.database) as tx:
            entry = tx.webhook_cursors.get(name).entry
        deliver(parts, entry, name)
    return queued


def plants(receiver):
    return [r.body.partition(b'"partitionkey":"')[2][:1].decode() for r in receiver.requests]


def test_what_is_of_no_interest_moves_the_cursor_and_wakes_nobody(parts):
    happen(parts, "a", kind="job:submitted")
    assert queue_due(parts, datetime.now(UTC)) == []
    assert not has_work(parts.database)
    state, _, size = shown(parts)
    assert state.sent == size


def test_a_delivery_is_queued_once_and_wakes_a_sleeping_worker(parts, receiver):
    happen(parts, "a")
    woken = threading.Thread(target=sleep_until_work, args=(parts.database, threading.Event()))
    woken.start()
    assert queue_due(parts, datetime.now(UTC)) == ["hook"]
    assert queue_due(parts, datetime.now(UTC)) == []
    woken.join(timeout=10)
    assert not woken.is_alive()
    _, cursor, _ = shown(parts)
    deliver(parts, "another", "hook")  # which is not the one under way
    assert receiver.requests == []
    deliver(parts, cursor.entry, "hook")
    assert plants(receiver) == ["a"]
    assert not has_work(parts.database)


def test_a_long_log_is_sent_in_rounds(parts, receiver, monkeypatch):
    monkeypatch.setattr(deliveries, "WINDOW", 3)
    happen(parts, *"abababab")
    assert run_due(parts) == ["hook"]
    assert sorted(plants(receiver)) == sorted("abababab")
    state, cursor, size = shown(parts)
    assert (state.sent, cursor.sent_beyond, cursor.entry) == (size, [], None)


def refuse_a(receiver, status=500):
    receiver.answer = lambda r: status if b'"partitionkey":"a"' in r.body else 204


def test_a_plant_that_is_refused_waits_alone_until_a_window_is_full(parts, receiver, monkeypatch):
    monkeypatch.setattr(deliveries, "WINDOW", 4)
    refuse_a(receiver)
    happen(parts, "a", "b")
    now = datetime.now(UTC)
    run_due(parts, now)
    happen(parts, "b", "b")
    run_due(parts, now)  # at once: it is the other's pause
    assert sorted(plants(receiver)) == ["a", "b", "b", "b"]
    assert shown(parts)[0].state == "failing"
    assert shown(parts)[0].due_at is not None
    happen(parts, "b", "b")
    run_due(parts, now)
    assert plants(receiver).count("b") == 3  # the window is full
    receiver.answer = lambda _: 204
    run_due(parts, now + timedelta(hours=1))
    with parts.database.write() as connection:  # whose pause is by the clock
        connection.exec_driver_sql("UPDATE webhook_cursors SET held = '{}'")
    run_due(parts, now + timedelta(hours=1))
    assert (plants(receiver).count("a"), plants(receiver).count("b")) == (2, 5)
    state, cursor, size = shown(parts)
    assert (state.state, state.sent, cursor.sent_beyond, cursor.held) == ("sending", size, [], {})


def test_behind_a_full_window_nothing_is_sent_and_patience_runs_on(parts, receiver, monkeypatch):
    monkeypatch.setattr(deliveries, "WINDOW", 1)
    refuse_a(receiver)
    happen(parts, "a", "b")
    run_due(parts)
    state, cursor, _ = shown(parts)
    assert plants(receiver) == ["a"]
    assert (state.state, state.attempts, cursor.entry) == ("failing", 1, None)
    assert state.failing_since is not None
    assert run_due(parts) == []


def test_a_plant_that_is_refused_for_ever_does_not_stop_a_webhook_that_accepts_others(
    parts, receiver
):
    refuse_a(receiver)
    happen(parts, "a", "b")
    run_due(parts)
    with parts.database.write() as connection:
        connection.exec_driver_sql(
            "UPDATE webhook_cursors SET failing_since = '2020-01-01T00:00:00.000000Z', held = '{}'"
        )
    happen(parts, "b")
    run_due(parts)
    assert shown(parts)[0].state == "failing"
    assert shown(parts)[0].failing_since is None


@pytest.mark.parametrize("status", [429, 503])
def test_a_receiver_that_asks_for_patience_is_left_alone_as_a_whole(parts, receiver, status):
    receiver.answer = lambda _: (status, {"Retry-After": "600"})
    happen(parts, "a", "a")
    now = datetime.now(UTC)
    run_due(parts, now)
    assert len(receiver.requests) == 1
    happen(parts, "b")
    assert run_due(parts, now + timedelta(seconds=590)) == []
    assert run_due(parts, now + timedelta(seconds=610)) == ["hook"]


def test_one_that_is_gone_is_gone_whatever_else_fails(parts, receiver):
    receiver.answer = lambda r: 410 if b'"partitionkey":"a"' in r.body else 503
    happen(parts, "a", "b")
    run_due(parts)
    assert shown(parts)[0].state == "stopped"


def test_pauses_double_up_to_an_hour_and_then_it_is_stopped(parts, receiver):
    receiver.answer = lambda _: 503
    happen(parts, "a")
    now, pauses = datetime.now(UTC), []
    for number in range(14):
        if number == 13:
            with parts.database.write() as connection:
                connection.exec_driver_sql(
                    "UPDATE webhook_cursors SET failing_since = '2020-01-01T00:00:00.000000Z'"
                )
        assert run_due(parts, now) == ["hook"]
        state, _, _ = shown(parts)
        if state.due_at is None:
            break
        due = datetime.fromisoformat(state.due_at)
        pauses.append((due - datetime.now(UTC)).total_seconds())
        assert run_due(parts, due - timedelta(seconds=1)) == []
        now = due
    assert [round(p) for p in pauses] == [5, 10, 20, 40, 80, 160, 320, 640, 1280, 2560, *[3600] * 3]
    state, _, _ = shown(parts)
    assert (state.state, state.problem) == ("stopped", "it answered 503")
    with reading(parts.database) as tx:
        last = tx.log.newest_entries(10**9, 1)[0]
    assert (last.kind, last.subject) == ("webhook:stopped", "hook")
    assert run_due(parts, now + timedelta(days=10)) == []
    receiver.answer = lambda _: 204
    with writing(parts.database) as tx:
        resume_webhook(tx, "hook", None, CONTEXT)
    assert run_due(parts) == ["hook"]
    assert shown(parts)[0].state == "sending"


def test_what_a_receiver_says_stands_in_no_log_and_breaks_nothing(parts, receiver, monkeypatch):
    monkeypatch.setattr(receiver, "body", "\x00\x1b[31mhidden words\n", raising=False)
    receiver.answer = lambda _: 410
    happen(parts, "a")
    run_due(parts)
    state, _, _ = shown(parts)
    assert "hidden words" in state.problem
    assert state.problem.isprintable()
    with reading(parts.database) as tx:
        facts = tx.log.newest_entries(10**9, 1)[0].facts
    assert facts["because"] == "it answered 410"


def test_a_host_that_is_not_allowed_any_more_is_not_sent_to(parts, receiver):
    happen(parts, "a")
    forbidden = replace(parts, settings=Settings(data_dir=parts.settings.data_dir))
    queue_due(forbidden, datetime.now(UTC))
    _, cursor, _ = shown(parts)
    deliver(forbidden, cursor.entry, "hook")
    assert receiver.requests == []
    assert shown(parts)[0].problem == "the service sends no webhooks"


def test_a_stale_look_changes_nothing(parts, receiver):
    happen(parts, "a", kind="job:submitted")
    _, stale, size = shown(parts)
    with writing(parts.database) as tx:
        resume_webhook(tx, "hook", 0, CONTEXT)
        assert not tx.webhook_cursors.advance(stale, size)
        assert not tx.webhook_cursors.begin(stale, "entry")
    assert shown(parts)[0].sent == 0
    with writing(parts.database) as tx:
        _, now_, _ = shown(parts)
        remove_webhook(tx, "hook", CONTEXT)
        assert not tx.webhook_cursors.begin(now_, "entry")


def test_a_delivery_that_the_engine_gave_up_is_queued_anew(parts, receiver):
    happen(parts, "a")
    queue_due(parts, datetime.now(UTC))
    _, cursor, _ = shown(parts)
    release_lost(parts)
    assert shown(parts)[1].entry == cursor.entry  # which the engine still has to run
    parts.queue.remove([cursor.entry])
    release_lost(parts)
    assert shown(parts)[1].entry is None
    assert run_due(parts) == ["hook"]


def test_a_webhook_that_is_resumed_meanwhile_goes_on_from_there_in_the_same_delivery(
    parts, receiver
):
    happen(parts, "a", "a", "a")
    begin = shown(parts)[0].sent

    def answer(_):
        if len(receiver.requests) == 1:
            with writing(parts.database) as tx:
                resume_webhook(tx, "hook", begin - 1, CONTEXT)
        return 204

    receiver.answer = answer
    run_due(parts)
    told = [r.headers["webhook-id"] for r in receiver.requests]
    assert told[:3] == told[3:]  # first what was under way, then all again
    assert shown(parts)[0].sent == shown(parts)[2]


def test_a_delivery_ends_after_some_rounds_so_that_others_have_their_turn(
    parts, receiver, monkeypatch
):
    monkeypatch.setattr(deliveries, "WINDOW", 1)
    monkeypatch.setattr(deliveries, "ROUNDS", 3)
    happen(parts, *"aaaaa")
    run_due(parts)
    assert len(receiver.requests) == 3
    run_due(parts)
    assert len(receiver.requests) == 5


def test_one_that_an_archive_brought_can_be_removed(parts):
    with parts.database.write() as connection:
        connection.exec_driver_sql("DELETE FROM webhook_cursors")
    with writing(parts.database) as tx:
        assert webhook(tx, "hook").state == "stopped"
        with pytest.raises(Conflict, match="archive"):
            resume_webhook(tx, "hook", None, CONTEXT)
        assert remove_webhook(tx, "hook", CONTEXT).state == "removed"
