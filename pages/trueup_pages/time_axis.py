"""The axis of time that pictures share: round moments within a range, in UTC."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

MINUTE, HOUR, DAY = 60, 3600, 86400
STEPS_S = (
    1, 2, 5, 10, 30, MINUTE, 2 * MINUTE, 5 * MINUTE, 10 * MINUTE, 30 * MINUTE,
    HOUR, 2 * HOUR, 6 * HOUR, 12 * HOUR, DAY, 2 * DAY, 7 * DAY, 14 * DAY,
    30 * DAY, 60 * DAY, 182 * DAY, 365 * DAY, 730 * DAY, 1825 * DAY,
)  # fmt: skip
MOST = 7  # moments on an axis


def seconds(at: str) -> float:
    """A time of the registry (ISO 8601) as seconds since 1970."""
    return datetime.fromisoformat(at).timestamp()


def ticks(first_s: float, last_s: float) -> list[tuple[float, str]]:
    """Round moments from one to another [s since 1970], and how each is written."""
    step = next((s for s in STEPS_S if (last_s - first_s) / s <= MOST), STEPS_S[-1])
    at = first_s - first_s % step + (step if first_s % step else 0)
    moments: list[tuple[float, str]] = []
    while at <= last_s and len(moments) <= 2 * MOST:
        moments.append((at, _written(at, step)))
        at += step
    return moments


def _written(at: float, step: float) -> str:
    """A moment, no finer than the step between two."""
    when = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=at)
    if step >= DAY:
        return f"{when:%Y-%m-%d}"
    clock = f"{when:%H:%M}" if step >= MINUTE else f"{when:%H:%M:%S}"
    return f"{when:%m-%d} {clock}" if clock in ("00:00", "00:00:00") else clock
