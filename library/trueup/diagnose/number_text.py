"""Numbers as people read them: to the digits that mean something, with their units."""

from __future__ import annotations

import math
from collections.abc import Sequence

DIGITS = 2  # of an uncertainty that are worth writing
SIGNIFICANT = 3  # digits of a number without one
# numbers from one to the other are written out, others with a power of ten
WRITTEN_OUT = (1e-3, 1e6)
OFF_CENTRE = 0.2  # of a half-width: an interval that lies further off is no ±
RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def unit(text: str) -> str:
    """A unit as it is printed: that of a bare number is nothing."""
    return "" if text == "1" else text.replace("^2", "²").replace("^3", "³")


def short(x: float | None) -> str:
    """Three digits of a number; a dash where there is none."""
    if x is None:
        return "–"
    if x == 0.0 or not math.isfinite(x):
        return f"{x:.0f}".replace("-0", "0").replace("-", "−")
    rounded = float(f"{x:.{SIGNIFICANT}g}")
    if WRITTEN_OUT[0] <= abs(rounded) < WRITTEN_OUT[1]:
        places = max(SIGNIFICANT - 1 - math.floor(math.log10(abs(rounded))), 0)
        text = f"{rounded:.{places}f}"
        return (text.rstrip("0").rstrip(".") if "." in text else text).replace("-", "−")
    power = math.floor(math.log10(abs(rounded)))
    return f"{short(rounded / 10.0**power)} × 10{_raised(power)}"


def plus_minus(value: float, half: float) -> str:
    """A value and its uncertainty, to the uncertainty's own digits."""
    if not (math.isfinite(half) and half > 0.0):
        return short(value)
    largest = max(abs(value), half)
    if not WRITTEN_OUT[0] <= largest < WRITTEN_OUT[1]:
        power = math.floor(math.log10(largest))
        scale = 10.0**power
        return f"({plus_minus(value / scale, half / scale)}) × 10{_raised(power)}"
    places = DIGITS - 1 - math.floor(math.log10(half))
    shown = max(places, 0)
    value = round(value, places) + 0.0  # no -0
    return f"{value:.{shown}f} ± {round(half, places):.{shown}f}".replace("-", "−")


def with_interval(value: float, ci95: Sequence[float | None]) -> str:
    """A value with its interval: as ± where that lies about it, else from where to where."""
    low, high = ci95
    if low is None or high is None:
        return short(value)
    half = (high - low) / 2.0
    if abs(value - (low + high) / 2.0) > OFF_CENTRE * half:
        return f"{short(value)} ({short(low)} to {short(high)})"
    return plus_minus(value, half)


def percent(share: float) -> str:
    """A share, with a digit more where it is small, or near the whole, to which it is not rounded
    up."""
    if share == 0.0:
        return "0 %"
    if share < 0.001:  # noqa: PLR2004 - the digits of a percentage
        return "< 0.1 %"
    if 0.99 <= share < 1.0:  # noqa: PLR2004
        return f"{min(100.0 * share, 99.9):.1f} %"
    return f"{100.0 * share:.{0 if share >= 0.1 else 1}f} %"  # noqa: PLR2004


def _raised(power: int) -> str:
    return str(power).translate(RAISED)
