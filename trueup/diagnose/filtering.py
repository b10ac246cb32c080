"""Filtering: the gain with which a corrected model follows an episode before it predicts.

Steady-state Kalman gain of the model linearised at rest; what the log does not tell, how much the machine is disturbed and whether
from sample to sample or for a while, is chosen by how well windows of the adaptation episodes are predicted.
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
from trueup.fit.rollout_fit import RolloutFit, in_parallel
from trueup.model.block import layout
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import Scheme
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
DOUBLINGS = 24  # of the time over which a filter settles: from one sample to days
LEAST, MOST = -7.0, 5.0  # decades of the motion's acceleration: a force that is random in each second, or wanders so far in one
COARSE = 2.0  # decades between the first sizes that are tried
FINEST = 0.4


def corrected(plant: Plant, admission: Admission, fit: RolloutFit, scheme: Scheme, episodes: Sequence[Episode]) -> Corrected:
    """The predictor of a fit, with the gain that predicts the given adaptation episodes best."""
    hypothesis, values = fit.hypothesis, fit.values.copy()
    if admission.coarse.any():
        hypothesis = Hypothesis((*hypothesis.effects, "sensor_quantization"))
        values[list(layout()["sensor_quantization"])] = np.where(admission.coarse, admission.lattice, 0.0)
    model = Corrected(plant, hypothesis, tuple(float(x) for x in values), scheme, begin=_first_velocity(plant, episodes))
    period = episodes[0].period_s

    def tried(kind: tuple[float, bool]) -> tuple[float, Corrected]:
        candidate = replace(model, gain=_gain(plant, admission, model, 10.0 ** kind[0], period, wanders=kind[1]))
        error = np.mean([squared_errors(candidate, e, plant.horizon_s, admission.motion).mean() for e in episodes])
        return (float(error) if np.isfinite(error) else np.inf), candidate

    def tried_all(kinds: Sequence[tuple[float, bool]]) -> dict[tuple[float, bool], tuple[float, Corrected]]:
        return dict(zip(kinds, in_parallel(tried, kinds), strict=True))

    found = tried_all([(size, wanders) for wanders in (False, True) for size in np.arange(LEAST, MOST + 1e-9, COARSE)])
    width = COARSE / 2.0
    while width > FINEST:
        size, wanders = min(found, key=lambda k: found[k][0])
        found |= tried_all([(size - width, wanders), (size + width, wanders)])
        width /= 2.0
    return min(found.values(), key=lambda pair: pair[0])[1]


def _first_velocity(plant: Plant, episodes: Sequence[Episode]) -> tuple[float, float, float]:
    """Weights of 1, position and command in the velocity that goes with them, by least squares over all samples."""
    states = np.concatenate([smoothed_states(plant, e) for e in episodes])
    u = np.concatenate([plant.applied(e.commands)[:, 0] for e in episodes])
    sound = np.isfinite(states).all(axis=1) & np.isfinite(u)
    terms = np.column_stack([np.ones(len(u)), states[:, 0], u])[sound]
    one, q, drive = np.linalg.lstsq(terms, states[sound, 1], rcond=None)[0]
    return float(one), float(q), float(drive)


def _gain(
    plant: Plant, admission: Admission, model: Corrected, size: float, period_s: float, *, wanders: bool
) -> tuple[tuple[float, float], ...]:
    """The steady gain `(3, 2)` for a disturbance of a size: a force random from sample to sample, or one that wanders and is estimated."""
    names = plant.dynamics.parameter_names
    h, seen, sizes = period_s, admission.observed, admission.scales
    unit = np.array([sizes.position, sizes.velocity, sizes.acceleration])  # keeps the equation well scaled
    a = np.eye(3)
    a[:2, :2] = plant.dynamics.transition(np.array(model.values[: len(names)]), h)
    a[:2, 2] = h * h / 2.0, h
    power = (sizes.acceleration * size) ** 2
    drive = np.zeros((3, 3))
    if wanders:
        drive[2, 2] = power * h
    else:
        drive[:2, :2] = np.array([[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]]) * power
    kept = slice(0, 3 if wanders else 2)
    noise = np.diag(np.maximum(admission.noise[seen], 1e-6 * admission.motion[seen]) ** 2)
    a, drive = (a * unit / unit[:, None])[kept, kept], (drive / unit / unit[:, None] + 1e-16 * np.eye(3))[kept, kept]
    c = (np.eye(3)[:2][seen] * unit)[:, kept]
    p = _steady(a, c.T @ np.linalg.solve(noise, c), drive)
    gain = np.zeros((3, 2))
    gain[kept, seen] = unit[kept, None] * (p @ c.T @ np.linalg.inv(c @ p @ c.T + noise))
    return tuple((float(x), float(y)) for x, y in gain)


def _steady(a: Array, information: Array, drive: Array) -> Array:
    """The covariance before an observation at which a filter's own equation stands still, by doubling the time it has run.

    `information` is what one observation adds, `drive` the covariance that one sample of disturbance adds; `(states, states)` each.
    """
    onward, gathered, p = a.T, information, drive
    for _ in range(DOUBLINGS):
        shared = np.linalg.inv(np.eye(len(a)) + gathered @ p)
        later = p + onward.T @ p @ shared @ onward
        gathered = gathered + onward @ shared @ gathered @ onward.T
        onward = onward @ shared @ onward
        if np.allclose(later, p, rtol=1e-12, atol=0.0):
            break
        p = later
    return p
