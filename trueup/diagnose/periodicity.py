"""Periodicity: at which pitches the acceleration that the nominal form misses repeats with the position.

A periodogram over position: the change of velocity over short spans, regressed on the family's own terms and on a sine and cosine
of position, summed over the span, for one pitch after another. Rollouts cannot be scanned so: a wrong pitch leads them astray.
Source: N. R. Lomb, Astrophysics and Space Science 39 (1976), with the span's integral for the sampled wave.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.admission import Admission
from trueup.episode.episode import Episode
from trueup.model.dynamics import CompiledFamily
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
KEPT = 5  # pitches
OVERSAMPLED = 4.0  # steps for each wave over the travel
SHORTEST, LONGEST = 0.02, 1.0  # of the largest deflection
NOISE = 0.2  # of the acceleration: spans are as long as the noise of a mean acceleration asks for
MOST_SPAN = 12  # samples


def pitches(plant: Plant, admission: Admission, episodes: Sequence[Episode]) -> list[tuple[list[float], list[float]]]:
    """Starts for a cogging fit of a family: its parameters, and (sine, cosine, pitch) in units of their scales, the strongest first."""
    if not isinstance(plant.dynamics, CompiledFamily):
        return []
    scales = admission.scales[0]
    reach = scales.position
    rates = np.arange(1.0 / (LONGEST * reach), 1.0 / (SHORTEST * reach), 1.0 / (2.0 * reach * OVERSAMPLED))
    totals = None
    for e in episodes:
        own, waves, target = _rows(plant, admission, e, rates)
        part = np.stack([np.column_stack([own, w, target]).T @ np.column_stack([own, w, target]) for w in waves])
        totals = part if totals is None else totals + part
    assert totals is not None
    left, sizes = _solved(totals)
    order = np.argsort(left, kind="stable")
    chosen: list[int] = []
    for i in order:
        if all(abs(int(i) - j) > OVERSAMPLED for j in chosen):
            chosen.append(int(i))
    n = len(plant.parameters)
    return [
        (list(sizes[i, :n]), [sizes[i, -2] / scales.acceleration, sizes[i, -1] / scales.acceleration, 1.0 / rates[i] / reach])
        for i in chosen[:KEPT]
    ]


def _rows(plant: Plant, admission: Admission, episode: Episode, rates: Array) -> tuple[Array, Array, Array]:
    """Span sums of the family's regressors `(rows, parameters)` and of waves `(rates, rows, 2)`, and changes of velocity `(rows,)`."""
    assert isinstance(plant.dynamics, CompiledFamily)
    states = smoothed_states(plant, episode)
    h = np.diff(episode.t_s)
    noise = admission.sigma[1] if np.isfinite(admission.sigma[1]) else admission.sigma[0] / episode.period_s
    span = int(np.clip(np.ceil(1.5 * noise / (NOISE * admission.scales[0].acceleration * episode.period_s)), 2, MOST_SPAN))
    q = 0.5 * (states[1:, 0] + states[:-1, 0])
    v = 0.5 * (states[1:, 1] + states[:-1, 1])
    u = plant.applied(episode.commands)[:-1, 0]
    own = np.column_stack([*plant.dynamics.family.regressors(q, v, u), np.ones(len(q)), np.sign(v)]) * h[:, None]
    starts = np.arange(0, len(h) - span, span)

    def summed(x: Array) -> Array:
        total = np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)])
        return np.asarray(total[starts + span] - total[starts])

    phase = 2.0 * np.pi * q[None, :] * rates[:, None]
    waves = np.stack([np.sin(phase) * h, np.cos(phase) * h], axis=2)
    sums = np.stack([summed(w) for w in waves])
    return summed(own), sums, states[starts + span, 1] - states[starts, 1]


def _solved(totals: Array) -> tuple[Array, Array]:
    """What is left of the target at each pitch, and the sizes of all terms."""
    size = np.sqrt(np.maximum(np.diagonal(totals, axis1=1, axis2=2), 1e-300))
    scaled = totals / size[:, :, None] / size[:, None, :]
    n = totals.shape[1] - 1
    by = np.linalg.solve(scaled[:, :n, :n] + 1e-9 * np.eye(n), scaled[:, :n, n:])[:, :, 0]
    left = 1.0 - np.einsum("pi,pi->p", by, scaled[:, :n, n])
    return left, by * size[:, n:] / size[:, :n]
