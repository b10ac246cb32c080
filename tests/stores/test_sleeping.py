"""A sleeping worker wakes when a job is queued, and not before."""

import threading
import time

import pytest
from sqlalchemy.exc import OperationalError

import trueup_worker.sleeping as module
from tests.support.made import plant_document
from trueup_service.actions.submission import Submission
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import PlantRecord
from trueup_service.registry.transaction import writing
from trueup_worker.sleeping import has_work, sleep_until_work

NOW = "2026-01-01T00:00:00.000000Z"
CONTEXT = ActorContext("tester", NOW)


@pytest.fixture
def parts(storage):
    parts = storage.build()
    parts.queue.prepare()
    with writing(parts.database) as tx:
        tx.plants.add(PlantRecord("plant", "0" * 64, plant_document(), NOW, "tester", None))
        tx.log.append(CONTEXT, "plant:registered", plant="plant", subject="plant", facts={})
    yield parts
    parts.close()


@pytest.fixture
def asleep(parts):
    """A thread that sleeps, and what ends it."""
    stop = threading.Event()
    thread = threading.Thread(target=sleep_until_work, args=(parts.database, stop), daemon=True)
    thread.start()
    time.sleep(0.5)
    assert thread.is_alive()
    yield thread, stop
    stop.set()
    thread.join(timeout=10)
    assert not thread.is_alive()


def submit(parts):
    with writing(parts.database) as tx:
        Submission(tx, parts.queue, "a" * 32, "plant", {}, CONTEXT).enqueue("fit", {})


def test_a_queued_job_wakes_it(parts, asleep):
    thread, _ = asleep
    submit(parts)
    thread.join(timeout=10)
    assert not thread.is_alive()
    assert has_work(parts.database)


def test_other_writes_do_not(parts, asleep):
    thread, _ = asleep
    with writing(parts.database) as tx:
        tx.idempotency.keep("scope", "key", "0" * 64, {}, NOW)
    thread.join(timeout=0.5)
    assert thread.is_alive()


def test_a_job_that_was_queued_before_wakes_it_at_once(parts):
    submit(parts)
    sleep_until_work(parts.database, threading.Event())


def test_it_ends_when_it_is_told_to_stop(asleep):
    thread, stop = asleep
    stop.set()
    thread.join(timeout=10)
    assert not thread.is_alive()


def test_a_lost_database_is_tried_again(parts, monkeypatch):
    failures = iter([OperationalError("SELECT 1", {}, Exception("gone"))])

    def look(database):
        if (error := next(failures, None)) is not None:
            raise error
        return True

    monkeypatch.setattr(module, "has_work", look)
    monkeypatch.setattr(module, "RETRY_S", 0.01)
    sleep_until_work(parts.database, threading.Event())
    assert next(failures, None) is None
