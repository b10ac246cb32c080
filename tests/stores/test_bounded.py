"""A year of a fleet's traffic leaves no more in the job engine and under idempotency keys than the
days for which they are kept."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import text

from trueup_service.actor_context import time_text
from trueup_service.expiry import remove_expired
from trueup_service.registry.transaction import reading, writing
from trueup_worker.tidying import purge

DAYS, A_DAY, KEPT_DAYS = 365, 12, 7
BEGIN = datetime(2026, 1, 1, tzinfo=UTC)


def test_a_year_of_traffic_leaves_a_week(storage):
    parts = storage.build()
    parts.queue.prepare()
    schema = "" if storage.name == "embedded" else "dbos."
    most_entries = most_answers = most_attempts = 0
    for day in range(DAYS):
        now = BEGIN + timedelta(days=day, hours=12)
        with writing(parts.database) as tx:
            for number in range(A_DAY):
                job = f"{day:04d}{number:028d}"
                parts.queue.enqueue(tx.connection, job, "fit", "plant")
                tx.attempts.begin(job, "a worker that died", time_text(now))
                tx.idempotency.keep(f"jobs@{number}", f"{day}", "0" * 64, {}, time_text(now))
            tx.connection.execute(
                text(
                    f"UPDATE {schema}workflow_status SET status = 'SUCCESS', completed_at = :ms, "
                    "created_at = :ms, updated_at = :ms WHERE status = 'ENQUEUED'"
                ),
                {"ms": int(now.timestamp() * 1000)},
            )
        if day % 7 == 3:  # a failed one, which is not tried again since no job is under way
            with writing(parts.database) as tx:
                tx.connection.execute(
                    text(
                        f"UPDATE {schema}workflow_status SET status = 'ERROR' "
                        "WHERE workflow_uuid = :job"
                    ),
                    {"job": f"{day:04d}{0:028d}"},
                )
        night = now + timedelta(hours=12)
        purge(parts, night)
        remove_expired(parts, night)
        with reading(parts.database) as tx:
            counts = [
                tx.connection.scalar(text(f"SELECT count(*) FROM {table}"))
                for table in (f"{schema}workflow_status", "idempotency", "attempts")
            ]
        entries, answers, attempts = counts
        most_entries, most_answers = max(most_entries, entries), max(most_answers, answers)
        most_attempts = max(most_attempts, attempts)
    assert most_entries == most_answers == most_attempts == KEPT_DAYS * A_DAY
    parts.close()


def test_a_failed_entry_stays_as_long_as_its_job_is_under_way(storage):
    parts = storage.build()
    parts.queue.prepare()
    schema = "" if storage.name == "embedded" else "dbos."
    with writing(parts.database) as tx:
        for job in ("a" * 32, "b" * 32):
            parts.queue.enqueue(tx.connection, job, "fit", "plant")
        tx.connection.execute(
            text(f"UPDATE {schema}workflow_status SET status = 'ERROR', completed_at = 1")
        )
    assert parts.queue.purge(BEGIN, {"a" * 32}) == 1
    assert parts.queue.names("") == ["a" * 32]
    parts.close()
