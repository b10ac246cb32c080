"""Odds: how much more probable a log is once it is mended.

A nominal model is roughly right: its numbers are off by some factor, and its form explains most of
what the joint does. A log of which that holds only after a change of unit, sign, scale or order
most probably has that fault. The odds are those of two explanations of the same log: lognormal
errors of the nominal numbers, and the residual of the form.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from trueup.doctor.balance import Balance
from trueup.doctor.tuning import PRIOR


def improbability(balance: Balance | None) -> float:
    """How improbable a joint's fitted numbers are [nats]: minus the logarithm of their probability
    over that of the nominal ones, bounded for each of them."""
    if balance is None:
        return 0.0
    return sum(_off(ratio, balance.errors[name]) for name, ratio in balance.ratios.items())


def _off(ratio: float, error: float) -> float:
    """How improbable one number is: its ratio to the nominal one, known to two standard errors."""
    low, high = ratio - 2.0 * error, ratio + 2.0 * error
    nearest = min(max(1.0, low), high)
    if nearest <= 0.0:
        return PRIOR.most
    sigma = np.log(PRIOR.off)
    return float(min(np.log(nearest) ** 2 / (2.0 * sigma**2), PRIOR.most))


def better_fit(before: Balance | None, after: Balance | None) -> float:
    """What it speaks for the second explanation that the command is plainer in the acceleration
    [nats]."""
    if before is None or after is None:
        return 0.0
    ratio = max(1.0 - before.of_command, 1e-9) / max(1.0 - after.of_command, 1e-9)
    return float(np.clip(PRIOR.fit * np.log(ratio), -PRIOR.most_fit, PRIOR.most_fit))


def evidence(before: Iterable[Balance | None], after: Iterable[Balance | None]) -> float:
    """What the joints' numbers and residuals speak for the second explanation [nats]."""
    return sum(
        improbability(b) - improbability(a) + better_fit(b, a)
        for b, a in zip(before, after, strict=True)
    )


def sound(balance: Balance | None) -> bool:
    """Whether nothing about a joint is in want of an explanation."""
    return balance is None or (
        balance.of_command > PRIOR.sound and improbability(balance) < PRIOR.little
    )


def log_odds(nats: float, prior: float) -> float:
    """The logarithm of the odds of a fault for which so much speaks, and which was so probable
    before."""
    return float(nats + np.log(prior / (1.0 - prior)))


def probability(odds: float) -> float:
    """The probability that belongs to the logarithm of odds."""
    return float(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0))))
