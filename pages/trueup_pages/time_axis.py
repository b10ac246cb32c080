"""The axis of time that pictures share: round moments within a range, in UTC."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

MINUTE, HOUR, DAY, YEAR = 60, 3600, 86400, 12  # the first three in seconds, a year in months
STEPS_S = (
    1, 2, 5, 10, 30, MINUTE, 2 * MINUTE, 5 * MINUTE, 10 * MINUTE, 30 * MINUTE,
    HOUR, 2 * HOUR, 6 * HOUR, 12 * HOUR, DAY, 2 * DAY, 7 * DAY,
)  # fmt: skip
STEPS_MONTHS = (1, 2, 3, 6, *(n * 10**power * YEAR for power in range(4) for n in (1, 2, 5)))
MONTH_S = 30.4 * DAY
MOST = 7  # moments on an axis


def seconds(at: str) -> float:
    """A time of the registry (ISO 8601) as seconds since 1970."""
    return datetime.fromisoformat(at).timestamp()


def ticks(first_s: float, last_s: float) -> list[tuple[float, str]]:
    """Round moments from one to another [s since 1970], and how each is written."""
    span = last_s - first_s
    step = next((s for s in STEPS_S if span / s <= MOST), None)
    if step is None:
        months = next((m for m in STEPS_MONTHS if span / (m * MONTH_S) <= MOST), STEPS_MONTHS[-1])
        return _of_months(first_s, last_s, months)
    at = first_s - first_s % step + (step if first_s % step else 0)
    moments: list[tuple[float, str]] = []
    while at <= last_s:
        moments.append((at, _written(at, step)))
        at += step
    return moments


def _of_months(first_s: float, last_s: float, step: int) -> list[tuple[float, str]]:
    """The first days of months or years, so many months apart."""
    begin, end = (datetime.fromtimestamp(at, UTC) for at in (first_s, last_s))
    first, last = (YEAR * at.year + at.month - 1 for at in (begin, end))
    moments = []
    for month in range(first - first % step + step, last + 1, step):
        when = datetime(month // YEAR, month % YEAR + 1, 1, tzinfo=UTC)
        moments.append((when.timestamp(), f"{when:%Y}" if step >= YEAR else f"{when:%Y-%m}"))
    return moments


def _written(at: float, step: float) -> str:
    """A moment, no finer than the step between two."""
    when = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=at)
    if step >= DAY:
        return f"{when:%Y-%m-%d}"
    clock = f"{when:%H:%M}" if step >= MINUTE else f"{when:%H:%M:%S}"
    return f"{when:%m-%d} {clock}" if clock in ("00:00", "00:00:00") else clock
