"""One worker process: the job engine, the recovery of jobs, and the schedule."""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import threading
import uuid

from trueup.cores import one_arena
from trueup_service.engine import DBOS, DBOSConfig, DBOSPortableJSONSerializer, StepOptions
from trueup_service.jobs import ENGINE_VERSION, HELP, QUEUE, WATCHING, WORKFLOW, plain_url
from trueup_service.wiring import Parts
from trueup_worker.fan_out import PREFIX
from trueup_worker.liveness import liveness_of
from trueup_worker.recovery import recover
from trueup_worker.run_help import Helping
from trueup_worker.run_job import compute, finish
from trueup_worker.schedule import run_schedule

log = logging.getLogger("trueup.worker")

WATCHED_AT_ONCE = 4  # a job begins when the queue is polled; one at a time would be ten a second
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
    one_arena()
    name = f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
    liveness = liveness_of(parts)
    liveness.acquire(name)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    if with_parent:
        threading.Thread(target=_until_parent_is_gone, args=(stop,), daemon=True).start()
    _launch(parts, name)
    log.info("working", extra={"worker": name})
    threading.Thread(
        target=recover,
        args=(parts.database, liveness, name, parts.settings.takeover_interval_s, stop),
        daemon=True,
    ).start()
    threading.Thread(
        target=run_schedule, args=(parts, parts.settings.schedule_interval_s, stop), daemon=True
    ).start()
    stop.wait()
    log.info("stopping", extra={"worker": name})
    DBOS.destroy(workflow_completion_timeout_sec=0)
    os._exit(0)  # another worker resumes a job under way


def _launch(parts: Parts, name: str) -> None:
    parts.queue.prepare()  # a finished job may submit another in its own transaction
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
    logging.getLogger("dbos").addFilter(_Withdrawn())

    helping = Helping(parts)

    @DBOS.workflow(name=HELP)  # type: ignore[untyped-decorator]
    def help_with(job_id: str, offer: str) -> str:
        return helping.answer(job_id, offer)  # it changes nothing, so a repetition needs no step

    @DBOS.workflow(name=WORKFLOW)  # type: ignore[untyped-decorator]
    def job(job_id: str) -> str:
        computed = DBOS.run_step({"name": "compute", **RETRIED}, compute, parts, job_id)
        return str(DBOS.run_step({"name": "finish", **RETRIED}, finish, parts, job_id, computed))

    DBOS.launch()
    every_s = parts.settings.job_poll_interval_s
    DBOS.register_queue(
        QUEUE, worker_concurrency=1, polling_interval_sec=every_s, on_conflict="always_update"
    )
    DBOS.register_queue(
        WATCHING,
        worker_concurrency=WATCHED_AT_ONCE,
        partition_concurrency=1,  # over all workers, of one plant
        polling_interval_sec=every_s,
        on_conflict="always_update",
    )


class _Withdrawn(logging.Filter):
    """Drops the engine's error about a batch that was withdrawn while a helper solved it."""

    def filter(self, record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else ""
        return f"workflow {PREFIX}" not in f"{record.getMessage()} {error}".lower()


def _until_parent_is_gone(stop: threading.Event) -> None:
    sys.stdin.read()
    stop.set()
