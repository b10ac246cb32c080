"""Periodicity: at which pitches the force that the nominal form misses at a joint repeats with its
position.

A periodogram over position: the change of velocity over short spans, of a robot the force that is
missing at the joint, regressed on the nominal form's own terms, and what they leave on a sine and
cosine of position summed over the span, for one pitch after another. Rollouts cannot be scanned so:
a wrong pitch leads them astray. Of a robot no other joint's effect comes into a joint's missing
force. Source: N. R. Lomb, Astrophysics and Space Science 39 (1976), with the span's integral for
the sampled wave.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.admission import Admission
from trueup.episode.episode import Episode
from trueup.fit.base_parameters import columns
from trueup.model.dynamics import CompiledFamily
from trueup.model.plant import Plant
from trueup.model.rounding import GUESS_BITS, rounded
from trueup.model.state import smoothed_states
from trueup.model.tree import GAIN, JOINT, LINK, OFFSET

Array = NDArray[np.float64]
Begin = tuple[Sequence[float], Sequence[float]]
KEPT = 5  # pitches
OVERSAMPLED = 4.0  # steps for each wave over the travel
SHORTEST, LONGEST = 0.02, 1.0  # of the largest deflection
NOISE = 0.2  # of the acceleration: spans are as long as the noise of a mean acceleration asks for
MOST_SPAN = 12  # samples
MOST_STEPS = 6000  # of all episodes are looked at
SHOWN = 1e-6  # of the largest singular value: a combination of terms that is there
FLAT = 1e-9  # of a wave: less is left of it once the form's own terms are taken out


def pitches(
    plant: Plant, admission: Admission, joint: int, episodes: Sequence[Episode]
) -> tuple[list[Begin], float]:
    """Starts for a cogging fit at a joint, the strongest first: a family's parameters with them, of
    a robot none, and (sine, cosine, pitch) in units of their scales; and the part of what the
    form's own terms leave that the strongest takes.
    """
    scales = admission.scales[joint]
    reach = scales.position
    rates = np.arange(
        1.0 / (LONGEST * reach), 1.0 / (SHORTEST * reach), 1.0 / (2.0 * reach * OVERSAMPLED)
    )
    parts = [_rows(plant, admission, joint, e, rates, len(episodes)) for e in episodes]
    own, waves, missing = (np.concatenate([p[i] for p in parts], axis=0) for i in range(3))
    if len(missing) < own.shape[1]:
        return [], 0.0
    basis, shown, _ = np.linalg.svd(
        own / np.maximum(np.linalg.norm(own, axis=0), 1e-300), full_matrices=False
    )
    basis = basis[:, shown > SHOWN * shown[0]]
    rest, swung = missing - basis @ (basis.T @ missing), waves - basis @ (basis.T @ waves)
    sine, cosine = swung[:, : len(rates)], swung[:, len(rates) :]
    inner = [
        np.einsum("ri,ri->i", x, y) for x, y in ((sine, sine), (sine, cosine), (cosine, cosine))
    ]
    at = rest @ sine, rest @ cosine
    across = inner[0] * inner[2] - inner[1] ** 2
    flat = (
        across <= FLAT * np.einsum("ri,ri->i", waves[:, : len(rates)], waves[:, : len(rates)]) ** 2
    )
    across = np.where(flat, np.inf, across)
    taken = rounded(
        (inner[2] * at[0] ** 2 - 2.0 * inner[1] * at[0] * at[1] + inner[0] * at[1] ** 2) / across
    )
    chosen: list[int] = []
    for i in np.argsort(-taken, kind="stable"):
        if all(abs(int(i) - k) > OVERSAMPLED for k in chosen):
            chosen.append(int(i))
    found: list[Begin] = []
    for i in chosen[:KEPT]:
        sizes = rounded(
            np.linalg.lstsq(
                np.column_stack([own, waves[:, [i, len(rates) + i]]]), missing, rcond=None
            )[0],
            GUESS_BITS,
        )
        family = (
            list(sizes[: len(plant.parameters)])
            if isinstance(plant.dynamics, CompiledFamily)
            else []
        )
        found.append(
            (
                family,
                [
                    sizes[-2] / scales.acceleration,
                    sizes[-1] / scales.acceleration,
                    1.0 / rates[i] / reach,
                ],
            )
        )
    return found, float(taken.max() / max(rest @ rest, 1e-300))


def _rows(
    plant: Plant, admission: Admission, joint: int, episode: Episode, rates: Array, shared: int
) -> tuple[Array, Array, Array]:
    """Span sums of the form's own terms `(rows, terms)`, of sines and then cosines `(rows, 2 x
    rates)`, of what is missing `(rows,)`."""
    joints = len(plant.joints)
    states = smoothed_states(plant, episode)
    every = max(1, len(episode.t_s) * shared // MOST_STEPS)
    marks = np.arange(0, len(episode.t_s), every)
    applied, t = plant.applied(episode.commands), episode.t_s
    issued = (
        np.add.reduceat(applied[:-1] * np.diff(t)[:, None], marks[:-1]) / np.diff(t[marks])[:, None]
        if every > 1
        else applied[:-1]
    )
    states, h = states[marks], np.diff(t[marks])
    noise = admission.sigma[joints + joint]
    noise = noise if np.isfinite(noise) else admission.sigma[joint] / episode.period_s
    period_s = episode.period_s * every
    span = int(
        np.clip(
            np.ceil(1.5 * noise / (NOISE * admission.scales[joint].acceleration * period_s)),
            2,
            MOST_SPAN,
        )
    )
    middle = 0.5 * (states[1:] + states[:-1])
    own, missing = _terms(
        plant, joint, middle, np.diff(states[:, joints:], axis=0) / h[:, None], issued
    )
    phase = 2.0 * np.pi * middle[:, joint, None] * rates
    waves = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
    known: NDArray[np.bool_] = np.isfinite(middle).all(axis=1) & np.isfinite(missing)
    starts = np.arange(0, len(h) - span, span)
    whole = (
        np.array([known[a:b].all() for a, b in pairwise([*starts, starts[-1] + span])])
        if len(starts)
        else np.zeros(0, np.bool_)
    )

    def summed(x: Array) -> Array:
        x = np.where(
            known if x.ndim == 1 else known[:, None], (h if x.ndim == 1 else h[:, None]) * x, 0.0
        )
        total = np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)])
        return np.asarray((total[starts + span] - total[starts])[whole])

    return summed(own), summed(waves), summed(missing)


def _terms(plant: Plant, joint: int, states: Array, a: Array, u: Array) -> tuple[Array, Array]:
    """The form's own terms `(rows, terms)`, with a constant force and dry friction, and the
    acceleration that they have to make up `(rows,)`. Of a robot both are forces in units of the
    joint's inertia, and the drive is as strong as declared, for it measures all else.
    """
    joints = len(plant.joints)
    q, v = states[:, :joints], states[:, joints:]
    more = np.column_stack([np.ones(len(q)), np.sign(v[:, joint])])
    if isinstance(plant.dynamics, CompiledFamily):
        return np.column_stack(
            [*plant.dynamics.family.regressors(q[:, 0], v[:, 0], u[:, 0]), more]
        ), a[:, 0]
    shows, _ = columns(plant, q, v, a, u)
    missing = shows[:, joint] @ np.array(plant.parameters) - plant.form.tree[joint, OFFSET]
    gain = LINK * joints + JOINT * joint + GAIN
    return np.column_stack(
        [np.delete(shows[:, joint], gain, axis=1), more]
    ), missing / plant.form.sizes[joint]
