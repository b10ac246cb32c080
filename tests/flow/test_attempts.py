"""A job whose process dies is begun again, but not for ever, and says what is known of its end."""

import os
import signal
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.flow.test_failures import until
from tests.support.case import write_recordings
from tests.support.service import Service
from tests.support.simulated import recorded_twice
from trueup_client import Client
from trueup_service.registry.attempts import IN_ORDER
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import build
from trueup_worker.computing import Computing

ATTEMPTS = 3


@contextmanager
def submitted(storage, request):
    """Parts on a storage in which a job is queued, without a worker, and the job's id."""
    plant, episodes, _ = recorded_twice("A1", ["quadratic_drag"], 21)
    service = Service(storage)
    with service.running(worker=False), Client(service.url, actor="tester") as client:
        client.register_plant(dict(plant.document))
        for file in write_recordings(storage.settings().data_dir.parent, episodes):
            client.upload_episode(plant.name, file)
        yield client.submit(plant.name, request)["id"]


@contextmanager
def computing(storage, **settings):
    """A worker's processes."""
    parts = build(storage.settings().model_copy(update=settings))
    computing = Computing(parts, "worker")
    try:
        yield computing, parts
    finally:
        for pool in (computing._jobs, computing._watching):
            pool.close()
        computing.rest()
        parts.close()


def running(parts, job):
    with reading(parts.database) as tx:
        return [a for a in tx.attempts.of(job) if a.ended is None]


def test_a_job_that_crashes_its_process_each_time_fails_with_what_is_known(storage):
    with (
        submitted(storage, {"kind": "diagnose"}) as job,
        computing(storage, job_attempts=ATTEMPTS) as (it, parts),
    ):
        (process,) = it._jobs._all
        crashes = 0

        def crash():
            nonlocal crashes
            for _ in range(ATTEMPTS):
                until(lambda: running(parts, job))
                time.sleep(0.3)  # it is at it
                os.kill(process._process.pid, signal.SIGSEGV)
                crashes += 1
                until(lambda: not running(parts, job))

        killer = threading.Thread(target=crash)
        killer.start()
        computed = it.compute(job)
        killer.join()
        assert crashes == ATTEMPTS
        assert computed["state"] == "failed"
        problem = computed["problem"]
        assert problem["code"] == "process-died"
        assert "3 times" in problem["detail"]
        assert "SIGSEGV" in problem["detail"]
        assert "Segmentation fault" in problem["facts"]["traceback"]
        assert problem["facts"]["worker"] == "worker"
        assert it.finish(job, computed) == "failed"
        with reading(parts.database) as tx:
            assert tx.jobs.get(job).result == {"problem": problem}
            assert all(a.ended is not None for a in tx.attempts.of(job))


def test_a_job_whose_process_died_once_succeeds(storage):
    with (
        submitted(storage, {"kind": "fit", "method": "identify"}) as job,
        computing(storage) as (it, parts),
    ):
        with writing(parts.database) as tx:
            tx.attempts.begin(job, "a dead worker", "2026-01-01T00:00:00.000000Z")
        assert it.compute(job)["state"] == "succeeded"


def test_only_attempts_that_ended_in_order_do_not_count(storage):
    parts = storage.build()
    now = "2026-01-01T00:00:00.000000Z"
    with writing(parts.database) as tx:
        attempts = tx.attempts
        assert attempts.begin("job", "a", now) == []
        assert attempts.begin("job", "a", now) == []  # the engine tries the step again
        attempts.end_all("a")  # it is stopped
        assert attempts.begin("job", "b", now) == []
        attempts.end("job", "b", "it crashed")
        assert [a.ended for a in attempts.begin("job", "b", now)] == ["it crashed"]
        # worker b is gone
        assert [a.ended for a in attempts.begin("job", "c", now)] == ["it crashed", None]
        assert [a.ended for a in attempts.of("job")] == [IN_ORDER, "it crashed", None, None]
        attempts.forget_before(now)
        assert len(attempts.of("job")) == 4
        attempts.forget("job")
        assert attempts.of("job") == []
    parts.close()


def test_a_job_that_takes_longer_than_it_may_is_ended(storage):
    with (
        submitted(storage, {"kind": "diagnose"}) as job,
        computing(storage, job_time_limit_s=1.0) as (it, _),
    ):
        computed = it.compute(job)
        assert (computed["state"], computed["problem"]["code"]) == ("failed", "time-limit")
        assert it.finish(job, computed) == "failed"


@pytest.mark.parametrize("storage", ["embedded"], indirect=True)  # a process's limit knows none
def test_a_job_that_needs_more_memory_than_it_may_have_fails_and_says_so(storage):
    limit = 768 << 20
    request = {
        "kind": "randomise",
        "plants": 1000,
        "steps": 2000,
        "context": {"by": "configuration"},
        "randomisation": {
            "numbers": [{"number": "k", "distribution": "uniform", "low": 0.9, "high": 1.1}]
        },
    }
    with (
        submitted(storage, request) as job,
        computing(storage, job_memory_limit_bytes=limit) as (it, _),
    ):
        computed = it.compute(job)
        (process,) = it._jobs._all
        limits = Path(f"/proc/{process._process.pid}/limits").read_text()
        assert f"Max data size             {limit} " in limits
        assert (computed["state"], computed["problem"]["code"]) == ("failed", "memory-limit")
