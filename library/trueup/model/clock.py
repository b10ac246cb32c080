"""Clock: whether a recording's interval and the declared step agree."""

from __future__ import annotations

from typing import Any

import numpy as np

# of the declared step: rounding of stamps is less, a loop that runs at another rate is more
OFF = 0.05


def declared_steps(spans_s: Any, timestep_s: float) -> Any:
    """How many declared steps [s] lie in each interval [s], one at least; of one or of an array."""
    return np.maximum(1, np.rint(np.asarray(spans_s) / timestep_s)).astype(np.int64)


def step_taken_s(period_s: float, timestep_s: float) -> float:
    """The step [s] that cuts an interval [s] into whole steps nearest the declared one."""
    return period_s / int(declared_steps(period_s, timestep_s))


def is_off_step(period_s: float, timestep_s: float) -> bool:
    """Whether a recording's median interval is no whole number of declared steps, within `OFF`."""
    return abs(step_taken_s(period_s, timestep_s) / timestep_s - 1.0) > OFF
