"""Explanation: a fault that may be why the nominal model does not fit a log, and what speaks for
it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from trueup.doctor.finding import Finding
from trueup.doctor.log import Log
from trueup.doctor.odds import evidence, log_odds, probability


@dataclass(frozen=True, slots=True)
class Explanation:
    """A fault, the log once it is mended, what speaks for it beside the motion [nats], and how
    probable it was before the log was seen."""

    finding: Finding
    mended: Log
    beside: float
    prior: float

    def odds(self, log: Log) -> float:
        """The logarithm of its odds on a log."""
        return log_odds(evidence(log.balances, self.mended.balances) + self.beside, self.prior)


def most_probable(log: Log, explanations: Sequence[Explanation]) -> Explanation | None:
    """The most probable explanation, its finding with its probability; None of none."""
    odds = [explanation.odds(log) for explanation in explanations]
    if not odds:
        return None
    best = max(range(len(odds)), key=lambda i: odds[i])
    finding = replace(explanations[best].finding, confidence=probability(odds[best]))
    return replace(explanations[best], finding=finding)
