"""Clock: whether a recording's interval and the declared step agree."""

from __future__ import annotations

# of the declared step: rounding of stamps is less, a loop that runs at another rate is more
OFF = 0.05


def off_step(period_s: float, timestep_s: float) -> str | None:
    """In words that a recording's median interval [s] is no whole number of declared steps [s], or
    nothing where it is, within `OFF`.

    Two digits are told, so that recordings of one loop are told alike.
    """
    steps = max(1, round(period_s / timestep_s))
    taken_s = period_s / steps
    if abs(taken_s / timestep_s - 1.0) <= OFF:
        return None
    return (
        f"recorded every {_ms(period_s)}, and the plant declares steps of "
        f"{1e3 * timestep_s:.3g} ms: they were taken as "
        f"{_ms(taken_s)} long, and a delay or a lag is known no better than that; "
        "declare the step of the loop that recorded"
    )


def _ms(seconds: float) -> str:
    return f"{float(f'{1e3 * seconds:.2g}'):g} ms"
