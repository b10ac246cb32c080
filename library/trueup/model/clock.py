"""Clock: whether a recording's interval and the declared step agree. Needs no numpy, so that pages
can say it."""

from __future__ import annotations

# of the declared step: rounding of stamps is less, a loop that runs at another rate is more
OFF = 0.05


def step_taken_s(period_s: float, timestep_s: float) -> float:
    """The step [s] that cuts an interval [s] into whole steps nearest the declared one."""
    return period_s / max(1, round(period_s / timestep_s))


def is_off_step(period_s: float, timestep_s: float) -> bool:
    """Whether a recording's median interval is no whole number of declared steps, within `OFF`."""
    return abs(step_taken_s(period_s, timestep_s) / timestep_s - 1.0) > OFF
