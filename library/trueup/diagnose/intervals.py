"""Intervals: what a 95 % interval of an estimate holds.

- Where noise is all that is left, an estimate's variance is that of the information of its fit,
  times what is left of a sample.
- Where something else acts, too, samples are no independent witnesses. Then the variance is what
  windows, or whole recordings, disagree by, whichever is more: recordings by Student's t of their
  number. It is never less than the first.
- How far finer steps of integration moved an estimate, and how far off its minimum the fit ended,
  are added in quadrature. A number between whose corners the error is flat has the width of the
  grid on which it was found, and the others what gives way to that.
- Where several minima cost about as much, the interval spans them all.
- Where recordings, each fitted alone, differ by more than their own intervals allow, the variance
  between them widens it, for what one more recording may show (`between_recordings`).

Source: H. White, Econometrica 50 (1982), for the variance of a model that is not exact; K.-Y.
Liang, S. L. Zeger, Biometrika 73 (1986), by clusters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from trueup.diagnose.tuning import SEARCH, SELECTION
from trueup.fit.rollout_fit import TWO_SIDED, RolloutFit
from trueup.model.block import kind

Array = NDArray[np.float64]
Name = tuple[str, str]  # (effect's term or "", parameter)
TAIL = 0.975  # of a distribution below the end of a two-sided 95 % interval
RIDGE = 1e-12  # of a determined direction's information
WIDEST = 1e7  # steps of a finite difference: an interval so wide says that nothing is known
NOTHING, UNKNOWN = 1e-100, 1e100  # information that is none, and the variance that goes with it
LEAST_CLUSTERS = 2  # one has nobody to disagree with


@dataclass(frozen=True, slots=True)
class Minima:
    """The minima of one composition that the data do not tell apart, the best first.

    `other` is the same fitted on other steps of integration; `wider` by how much half of an
    interval grows, in quadrature, for what recordings differ by, by (effect or "", parameter).
    """

    fits: Sequence[RolloutFit]
    other: RolloutFit
    wider: Mapping[Name, float] = field(default_factory=dict)

    @property
    def best(self) -> RolloutFit:
        """The one that costs least."""
        return self.fits[0]

    def widened(self, names: Sequence[Name]) -> Array:
        """By how much half of each number's interval grows, `(names,)`."""
        return np.array([self.wider.get(name, 0.0) for name in names])


def intervals(minima: Minima) -> dict[Name, tuple[float, float]]:
    """Each number's 95 % interval, by (effect or "", parameter)."""
    spans: dict[Name, tuple[float, float]] = {}
    for fit in minima.fits:
        at, width = fit.free.at(fit.values), half_widths(fit, minima.other)
        for name, x in zip(fit.free.names, at, strict=True):
            half = float(np.hypot(width[name], minima.wider.get(name, 0.0)))
            low, high = float(x) - half, float(x) + half
            known = spans.get(name, (low, high))
            spans[name] = min(low, known[0]), max(high, known[1])
    return spans


def half_widths(fit: RolloutFit, other: RolloutFit) -> dict[Name, float]:
    """Half of each 95 % interval of one minimum, by (effect or "", parameter)."""
    if not len(fit.free.rows):
        return {}
    rest = np.array([t == "" or kind(t).grid_refined != n for t, n in fit.free.names])
    at = fit.free.at(fit.values)
    grid = np.where(rest, 0.0, 2.0 * SEARCH.grids[-1] * at)
    inverse = _inverse(fit.information[np.ix_(rest, rest)])
    grid[rest] = inverse @ (fit.information[np.ix_(rest, ~rest)] @ grid[~rest])
    variance = np.zeros(len(rest))
    variance[rest] = np.diag(covariance(fit)[np.ix_(rest, rest)])
    width = TWO_SIDED * np.sqrt(variance)
    moved = at - fit.free.at(other.values)
    whole = np.sqrt(width**2 * (1.0 + min(fit.distance or 0.0, 1.0) ** 2) + moved**2 + grid**2)
    return {
        name: float(w)
        for name, w in zip(fit.free.names, np.minimum(whole, WIDEST * fit.free.step), strict=True)
    }


def covariance(fit: RolloutFit) -> Array:
    """Covariance of a fit's free numbers, `(free, free)`, scaled so that 1.96 standard errors are
    half an interval."""
    inverse = inverse_information(fit)
    spread = inverse * max(fit.reduced_chi_square, 1.0)
    if fit.reduced_chi_square <= SELECTION.adequate:
        return spread
    recordings = np.array([part.sum(axis=0) for part in fit.split(fit.scores).values()])
    for scores, students in (
        (fit.scores, TWO_SIDED),
        (recordings, float(stdtrit(max(len(recordings) - 1, 1), TAIL))),
    ):
        if len(scores) >= LEAST_CLUSTERS:
            moved = (scores - scores.mean(axis=0)) @ inverse
            by_clusters = (
                moved.T @ moved * len(scores) / (len(scores) - 1) * (students / TWO_SIDED) ** 2
            )
            wider = np.sqrt(
                np.maximum(np.diag(by_clusters) / np.maximum(np.diag(spread), 1e-300), 1.0)
            )
            spread = spread * wider[:, None] * wider
    return spread


def inverse_information(fit: RolloutFit) -> Array:
    """Covariance of a fit's free numbers where noise is all that is left, `(free, free)`; 0 for a
    number that is sought on a grid."""
    rest = np.array([t == "" or kind(t).grid_refined != n for t, n in fit.free.names])
    inverse = np.zeros((len(rest), len(rest)))
    inverse[np.ix_(rest, rest)] = _inverse(fit.information[np.ix_(rest, rest)])
    return inverse


def _inverse(information: Array) -> Array:
    """The inverse of a normal matrix `(free, free)`; a number that nothing determines has the
    variance UNKNOWN."""
    informed = np.diag(information) > NOTHING
    inverse = np.diag(np.where(informed, 0.0, UNKNOWN))
    if informed.any():
        part = information[np.ix_(informed, informed)]
        size = np.sqrt(np.diag(part))
        inverse[np.ix_(informed, informed)] = (
            np.linalg.inv(part / size[:, None] / size + RIDGE * np.eye(len(size)))
            / size[:, None]
            / size
        )
    return np.asarray(inverse)
