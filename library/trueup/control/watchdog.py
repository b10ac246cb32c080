"""Watchdog: when the last sample is too old, the command is zero."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Watchdog:
    """Holds the age of the last sample against a timeout [s]."""

    timeout_s: float
    last_sample_s: float

    def sampled(self, now_s: float) -> Watchdog:
        """The watchdog after a sample."""
        return Watchdog(self.timeout_s, now_s)

    def age_s(self, now_s: float) -> float:
        """Age of the last sample [s]."""
        return now_s - self.last_sample_s

    def trips(self, now_s: float) -> bool:
        """Whether the command must be forced to zero."""
        return self.age_s(now_s) > self.timeout_s


@dataclass(frozen=True, slots=True)
class FaultInjection:
    """What a simulated sensor failure showed: first trip [s], forced commands, peak age [s]. A
    sketch, not hardware evidence."""

    first_trip_s: float | None
    forced: int
    peak_age_s: float


def inject_sensor_failure(
    control_s: float, sensor_s: float, timeout_s: float, ticks: int, dies_at: int
) -> FaultInjection:
    """Run the watchdog while the sensor stops at tick `dies_at`.

    Each tick, in order: take a sample if the sensor lives and its next time has come; age = now -
    last sample; force the command to zero if age > timeout; advance time by repeated addition, as a
    controller does.
    """
    watchdog = Watchdog(timeout_s, 0.0)
    now_s = next_sample_s = peak_s = 0.0
    first_trip_s, forced = None, 0
    for tick in range(ticks):
        if tick < dies_at and now_s >= next_sample_s:
            watchdog = watchdog.sampled(now_s)
            next_sample_s += sensor_s
        peak_s = max(peak_s, watchdog.age_s(now_s))
        if watchdog.trips(now_s):
            forced += 1
            first_trip_s = now_s if first_trip_s is None else first_trip_s
        now_s += control_s
    return FaultInjection(first_trip_s, forced, peak_s)
