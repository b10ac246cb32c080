"""Step warning: in words that a recording was not made at the declared step. Needs no numpy, so
that pages can say it."""

from __future__ import annotations

from trueup.model.clock import is_off_step, step_taken_s


def off_step(period_s: float, timestep_s: float) -> str | None:
    """In words that a recording's median interval [s] is no whole number of declared steps [s];
    None where it is.

    Two digits are given, so that recordings of one loop get one sentence.
    """
    if not is_off_step(period_s, timestep_s):
        return None
    return (
        f"recorded every {_ms(period_s)}, but the plant declares steps of "
        f"{1e3 * timestep_s:.3g} ms: the steps were taken as "
        f"{_ms(step_taken_s(period_s, timestep_s))} long, so delays and lags are no more accurate "
        "than that; declare the time step of the recording loop"
    )


def _ms(seconds: float) -> str:
    return f"{float(f'{1e3 * seconds:.2g}'):g} ms"
