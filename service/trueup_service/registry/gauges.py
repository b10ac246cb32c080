"""Gauges: what an operator watches of a registry as a whole, in a few statements that stay cheap
however large it is."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import func, select

from trueup_service.actor_context import time_text
from trueup_service.registry import tables as t
from trueup_service.registry.jobs import UNFINISHED
from trueup_service.registry.records import JobState
from trueup_service.registry.transaction import ReadTransaction

HOUR = timedelta(hours=1)


@dataclass(frozen=True, slots=True)
class Gauge:
    """A gauge in Prometheus' form: its name and meaning, the name of its label, and its value by
    label; of a gauge without a label, by the empty text."""

    name: str
    meaning: str
    label: str
    values: dict[str, float]


def gauges(tx: ReadTransaction, now: datetime) -> list[Gauge]:
    """All gauges of a registry at a time."""
    return [*_jobs(tx, now), _alarms(tx), *_webhooks(tx), _log(tx)]


def _jobs(tx: ReadTransaction, now: datetime) -> list[Gauge]:
    of = t.jobs.c
    counts = dict.fromkeys(map(str, UNFINISHED), 0.0)
    rows = tx.connection.execute(
        select(of.state, func.count()).where(of.state.in_(UNFINISHED)).group_by(of.state)
    )
    counts |= {str(state): float(count) for state, count in rows}
    first = tx.connection.scalar(select(func.min(of.created_at)).where(of.state == JobState.QUEUED))
    waiting_s = 0.0 if first is None else (now - datetime.fromisoformat(first)).total_seconds()
    failed = tx.connection.scalar(
        select(func.count()).where(
            of.state == JobState.FAILED, of.updated_at >= time_text(now - HOUR)
        )
    )
    return [
        Gauge("trueup_jobs", "Jobs that have not ended, by state", "state", counts),
        Gauge(
            "trueup_job_waiting_seconds",
            "How long the oldest queued job has waited [s]",
            "",
            {"": max(0.0, waiting_s)},
        ),
        Gauge(
            "trueup_jobs_failed_last_hour",
            "Jobs that failed within an hour",
            "",
            {"": float(failed or 0)},
        ),
    ]


def _alarms(tx: ReadTransaction) -> Gauge:
    count = tx.connection.scalar(select(func.count()).where(t.alarms.c.closed_at.is_(None)))
    return Gauge("trueup_alarms_open", "Alarms that are open", "", {"": float(count or 0)})


def _webhooks(tx: ReadTransaction) -> list[Gauge]:
    of, size = t.webhook_cursors.c, tx.log.size()
    rows = tx.connection.execute(
        select(of.webhook, of.sent, of.problem, of.stopped_at)
        .join(t.webhooks, t.webhooks.c.name == of.webhook)
        .where(t.webhooks.c.removed_at.is_(None))
    ).all()
    return [
        Gauge(
            "trueup_webhook_behind_entries",
            "Entries of the log that a webhook has not been told",
            "webhook",
            {str(row.webhook): float(size - row.sent) for row in rows},
        ),
        Gauge(
            "trueup_webhook_failing",
            "Whether a webhook fails (1), or was stopped (2)",
            "webhook",
            {str(row.webhook): _failing(row.stopped_at, row.problem) for row in rows},
        ),
    ]


def _failing(stopped_at: str | None, problem: str | None) -> float:
    return 2.0 if stopped_at is not None else float(problem is not None)


def _log(tx: ReadTransaction) -> Gauge:
    return Gauge("trueup_log_entries", "Entries of the audit log", "", {"": float(tx.log.size())})
