"""Filtering: the gain with which a corrected model follows an episode before it predicts.

Steady-state Kalman gain of the model linearised at rest; the one number that the log does not tell, how much the machine is
disturbed, is chosen by how well windows of the adaptation episodes are predicted.
Source: B. D. O. Anderson, J. B. Moore, Optimal Filtering (1979), chapter 4; the doubling: B. D. O. Anderson,
International Journal of Control 28 (1978).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.admission import Admission
from trueup.diagnose.measure import squared_errors
from trueup.episode.episode import Episode
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import layout
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import Scheme

Array = NDArray[np.float64]
DOUBLINGS = 24  # of the time over which a filter settles: from one sample to days
DISTURBANCES = tuple(10.0**e for e in range(-7, 6))  # of the motion's acceleration, as a random force in one second


def corrected(plant: Plant, admission: Admission, fit: RolloutFit, scheme: Scheme, episodes: Sequence[Episode]) -> Corrected:
    """The predictor of a fit, with the gain that predicts the given adaptation episodes best."""
    hypothesis, values = fit.hypothesis, fit.values.copy()
    if admission.coarse.any():
        hypothesis = Hypothesis((*hypothesis.effects, "sensor_quantization"))
        values[list(layout()["sensor_quantization"])] = np.where(admission.coarse, admission.lattice, 0.0)
    model = Corrected(plant, hypothesis, tuple(float(x) for x in values), scheme, ((1.0, 0.0), (0.0, 1.0)))
    tried = []
    for size in DISTURBANCES:
        candidate = replace(model, gain=_gain(plant, admission, model, size, episodes[0].period_s))
        error = np.mean([squared_errors(candidate, e, plant.horizon_s, admission.motion).mean() for e in episodes])
        tried.append((float(error) if np.isfinite(error) else np.inf, candidate))
    return min(tried, key=lambda pair: pair[0])[1]


def _gain(
    plant: Plant, admission: Admission, model: Corrected, size: float, period_s: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    names = plant.dynamics.parameter_names
    a = plant.dynamics.transition(np.array(model.values[: len(names)]), period_s)
    seen = admission.observed
    c = np.eye(2)[seen]
    noise = np.diag(np.maximum(admission.noise[seen], 1e-6 * admission.motion[seen]) ** 2)
    push = admission.scales.acceleration * size
    drive = np.array([[period_s**3 / 3, period_s**2 / 2], [period_s**2 / 2, period_s]]) * push**2
    unit = np.diag([admission.scales.position, admission.scales.velocity])  # keeps the equation well scaled
    inverse = np.linalg.inv(unit)
    a, drive, c = inverse @ a @ unit, inverse @ drive @ inverse + 1e-16 * np.eye(2), c @ unit
    p = _steady(a, c.T @ np.linalg.solve(noise, c), drive)
    gain = np.zeros((2, 2))
    gain[:, seen] = unit @ p @ c.T @ np.linalg.inv(c @ p @ c.T + noise)
    return (float(gain[0, 0]), float(gain[0, 1])), (float(gain[1, 0]), float(gain[1, 1]))


def _steady(a: Array, information: Array, drive: Array) -> Array:
    """The covariance before an observation at which a filter's own equation stands still, by doubling the time it has run.

    `information` is what one observation adds, `drive` the covariance that one sample of disturbance adds; `(2, 2)` each.
    """
    onward, gathered, p = a.T, information, drive
    for _ in range(DOUBLINGS):
        shared = np.linalg.inv(np.eye(2) + gathered @ p)
        later = p + onward.T @ p @ shared @ onward
        gathered = gathered + onward @ shared @ gathered @ onward.T
        onward = onward @ shared @ onward
        if np.allclose(later, p, rtol=1e-12, atol=0.0):
            break
        p = later
    return p
