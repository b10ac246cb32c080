"""One worker process: the job engine while there are jobs, the recovery of jobs, the schedule, the
deliveries of events, and what is kept for a limited time."""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import threading
import uuid
from contextlib import suppress
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from trueup.cores import own_cores
from trueup_service import open_telemetry
from trueup_service.engine import DBOS, DBOSConfig, DBOSPortableJSONSerializer, StepOptions
from trueup_service.jobs import (
    DELIVERY,
    ENGINE_VERSION,
    PART,
    PARTS,
    QUEUE,
    WATCHING,
    WEBHOOKS,
    WORKFLOW,
    plain_url,
)
from trueup_service.open_telemetry import span
from trueup_service.registry.transaction import writing
from trueup_service.wiring import Parts
from trueup_worker.compute_process import WORKER
from trueup_worker.computing import Computing, tell_of_job
from trueup_worker.deliveries import deliver, run_deliveries
from trueup_worker.liveness import Liveness, liveness_of
from trueup_worker.recovery import recover, require_held
from trueup_worker.schedule import run_schedule
from trueup_worker.sleeping import sleep_until_work
from trueup_worker.tidying import run_tidying

log = logging.getLogger("trueup.worker")

WATCHED_AT_ONCE = 4  # a job begins when the queue is polled; one at a time would be ten a second
DELIVERED_AT_ONCE = 4  # webhooks
DRAIN_S = 1  # that the engine waits for its workflows when it is ended; there are none
# a minute of a lost database
RETRIED: StepOptions = {
    "retries_allowed": True,
    "interval_seconds": 0.5,
    "backoff_rate": 2.0,
    "max_attempts": 8,
}


def work(parts: Parts, *, with_parent: bool = False) -> None:
    """Runs jobs until SIGTERM or SIGINT.

    With `with_parent` it also ends when standard input closes, as it does when the parent dies.
    """
    open_telemetry.start(WORKER)
    name = f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
    liveness = liveness_of(parts)
    liveness.acquire(name)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    if with_parent:
        threading.Thread(target=_until_parent_is_gone, args=(stop,), daemon=True).start()
    threading.Thread(
        target=run_schedule, args=(parts, parts.settings.schedule_interval_s, stop), daemon=True
    ).start()
    threading.Thread(target=run_tidying, args=(parts, stop), daemon=True).start()
    threading.Thread(target=run_deliveries, args=(parts, stop), daemon=True).start()
    computing = Computing(parts, name)
    _register(parts, computing)
    threading.Thread(target=computing.warm_up, daemon=True).start()
    parts.queue.prepare()
    log.info("working", extra={"worker": name})
    _work_and_sleep(parts, name, computing, liveness, stop)
    log.info("stopping", extra={"worker": name})
    with suppress(SQLAlchemyError), writing(parts.database) as tx:
        tx.attempts.end_all(name)
    open_telemetry.flush()
    os._exit(0)  # another worker resumes a job under way


def _work_and_sleep(
    parts: Parts, name: str, computing: Computing, liveness: Liveness, stop: threading.Event
) -> None:
    while not stop.is_set():
        sleep_until_work(parts.database, stop, lambda: require_held(liveness))
        if stop.is_set():
            return
        _launch(parts, name)
        recover(parts.database, liveness, name, parts.settings.takeover_interval_s, stop)
        if not stop.is_set():
            DBOS.destroy(workflow_completion_timeout_sec=DRAIN_S)
            computing.rest()


def _register(parts: Parts, computing: Computing) -> None:
    """Names what the engine runs. Called once, since names stay while the engine is away."""

    @DBOS.workflow(name=PART)  # type: ignore[untyped-decorator]
    def part(job_id: str, asked: Any, trace: str | None = None) -> dict[str, Any]:
        entry = DBOS.workflow_id
        with span("part of a job", trace, trueup__job=job_id):
            answer = DBOS.run_step(
                {"name": "part", **RETRIED}, computing.part, entry, job_id, asked
            )
        return dict(answer)

    @DBOS.workflow(name=WORKFLOW)  # type: ignore[untyped-decorator]
    def job(job_id: str, trace: str | None = None) -> str:
        with span("job", trace, trueup__job=job_id) as of_job:
            computed = DBOS.run_step({"name": "compute", **RETRIED}, computing.compute, job_id)
            state = DBOS.run_step({"name": "finish", **RETRIED}, computing.finish, job_id, computed)
            if of_job is not None:
                tell_of_job(parts, of_job, job_id)
        return str(state)

    @DBOS.workflow(name=DELIVERY)  # type: ignore[untyped-decorator]
    def delivery(webhook: str) -> None:
        entry = DBOS.workflow_id
        DBOS.run_step({"name": "deliver", **RETRIED}, deliver, parts, entry, webhook)


def _launch(parts: Parts, name: str) -> None:
    """Starts the engine. It resumes what it still has under this worker's name."""
    config: DBOSConfig = {
        "name": "trueup",
        "system_database_url": plain_url(parts.settings.sqlalchemy_url),
        "application_version": ENGINE_VERSION,
        "executor_id": name,
        "serializer": DBOSPortableJSONSerializer(),
        "log_level": "WARNING",
        "run_migrations": False,
    }
    DBOS(config=config)
    DBOS.launch()
    every_s = parts.settings.job_poll_interval_s
    at_once = {
        QUEUE: 1,
        PARTS: len(own_cores()),
        WATCHING: WATCHED_AT_ONCE,
        WEBHOOKS: DELIVERED_AT_ONCE,
    }
    for queue, concurrency in at_once.items():
        DBOS.register_queue(
            queue,
            worker_concurrency=concurrency,
            partition_concurrency=1 if queue == WATCHING else None,  # of one plant
            polling_interval_sec=every_s,
            on_conflict="always_update",
        )


def _until_parent_is_gone(stop: threading.Event) -> None:
    sys.stdin.read()
    stop.set()
