"""Spatial periods: with which periods the force that the nominal form misses at a joint repeats
with its position.

A periodogram over position: the change of velocity over short spans, of a robot the force that is
missing at the joint, regressed on the nominal form's own terms, and what they leave on a sine and
cosine of position summed over the span, for one period after another. Rollouts cannot be
scanned so: a wrong period leads them astray. Of a robot no other joint's effect comes into a
joint's missing force. By hand, since scipy.signal.lombscargle takes a constant for common term
and nothing else. Source: N. R. Lomb, Astrophysics and Space Science 39 (1976), with the
span's integral for the sampled wave.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.tuning import SETUP
from trueup.episode.episode import Episode
from trueup.fit.base_parameters import columns
from trueup.model.dynamics import CompiledFamily, Dynamics
from trueup.model.plant import Plant
from trueup.model.rounding import GUESS_BITS, rounded
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.state import smoothed_states
from trueup.model.tree import GAIN, JOINT, LINK, OFFSET

Array = NDArray[np.float64]
# numbers of a family, of a robot none, and a sine, a cosine and a period in units of their scales
PeriodicGuess = tuple[Sequence[float], Sequence[float]]
SHOWN = 1e-6  # of the largest singular value: a combination of terms that is there
FLAT = 1e-9  # of a wave: less is left of it once the form's own terms are taken out


def spatial_periods(
    plant: Plant, quality: DataQuality, joint: int, episodes: Sequence[Episode]
) -> tuple[list[PeriodicGuess], float]:
    """Starts for a cogging fit at a joint, the strongest first: a family's parameters with them, of
    a robot none, and (sine, cosine, period) in units of their scales; and the part of what the
    form's own terms leave that the strongest takes.
    """
    scales = quality.scales[joint]
    reach = scales.position
    rates = np.arange(
        1.0 / (SETUP.longest_period * reach),
        1.0 / (SETUP.shortest_period * reach),
        1.0 / (2.0 * reach * SETUP.period_steps),
    )
    parts = [_rows(plant, quality, joint, e, rates, len(episodes)) for e in episodes]
    own, waves, missing = (np.concatenate([p[i] for p in parts], axis=0) for i in range(3))
    if len(missing) < own.shape[1]:
        return [], 0.0
    basis, shown, _ = np.linalg.svd(
        own / np.maximum(np.linalg.norm(own, axis=0), 1e-300), full_matrices=False
    )
    basis = basis[:, shown > SHOWN * shown[0]]
    rest = missing - basis @ (basis.T @ missing)
    # less what the form's own terms can take of the waves
    whole = _products(waves)
    inner = [x - taken for x, taken in zip(whole, _products(basis.T @ waves), strict=True)]
    at = np.split(rest @ waves, 2)
    across = inner[0] * inner[2] - inner[1] ** 2
    across = np.where(across <= FLAT * whole[0] ** 2, np.inf, across)
    taken = rounded(
        (inner[2] * at[0] ** 2 - 2.0 * inner[1] * at[0] * at[1] + inner[0] * at[1] ** 2) / across
    )
    chosen: list[int] = []
    for i in np.argsort(-taken, kind="stable"):
        if all(abs(int(i) - k) > SETUP.period_steps for k in chosen):
            chosen.append(int(i))
    guesses: list[PeriodicGuess] = []
    for i in chosen[: SETUP.periods_kept]:
        sizes = rounded(
            np.linalg.lstsq(
                np.column_stack([own, waves[:, [i, len(rates) + i]]]), missing, rcond=None
            )[0],
            GUESS_BITS,
        )
        family = _family_numbers(plant.dynamics, plant, sizes)
        guesses.append(
            (
                family,
                [
                    sizes[-2] / scales.acceleration,
                    sizes[-1] / scales.acceleration,
                    1.0 / rates[i] / reach,
                ],
            )
        )
    return guesses, float(taken.max() / max(rest @ rest, 1e-300))


def _products(waves: Array) -> list[Array]:
    """Of sines and then cosines `(rows, 2 x rates)`, the inner products of each sine with itself,
    with its cosine, and of the cosine with itself, `(rates,)` each."""
    sine, cosine = np.hsplit(waves, 2)
    pairs = ((sine, sine), (sine, cosine), (cosine, cosine))
    return [np.einsum("ri,ri->i", x, y) for x, y in pairs]


def _rows(
    plant: Plant, quality: DataQuality, joint: int, episode: Episode, rates: Array, shared: int
) -> tuple[Array, Array, Array]:
    """Span sums of the form's own terms `(rows, terms)`, of sines and then cosines `(rows, 2 x
    rates)`, of what is missing `(rows,)`."""
    joints = len(plant.joints)
    states = smoothed_states(plant, episode)
    every = max(1, len(episode.t_s) * shared // SETUP.period_samples)
    marks = np.arange(0, len(episode.t_s), every)
    applied, t = plant.applied(episode.commands), episode.t_s
    issued = (
        np.add.reduceat(applied[:-1] * np.diff(t)[:, None], marks[:-1]) / np.diff(t[marks])[:, None]
        if every > 1
        else applied[:-1]
    )
    states, h = states[marks], np.diff(t[marks])
    noise = quality.sigma[joints + joint]
    noise = noise if np.isfinite(noise) else quality.sigma[joint] / episode.period_s
    period_s = episode.period_s * every
    span = int(
        np.clip(
            np.ceil(
                1.5 * noise / (SETUP.period_noise * quality.scales[joint].acceleration * period_s)
            ),
            2,
            SETUP.longest_span,
        )
    )
    middle = 0.5 * (states[1:] + states[:-1])
    own, missing = _terms(
        plant, joint, middle, np.diff(states[:, joints:], axis=0) / h[:, None], issued
    )
    known: NDArray[np.bool_] = np.isfinite(middle).all(axis=1) & np.isfinite(missing)
    count = max(len(h) - 1, 0) // span

    def by_span(x: Array | NDArray[np.bool_]) -> NDArray[Any]:
        return x[: count * span].reshape(count, span, *x.shape[1:])

    whole = by_span(known).all(axis=1)
    h, place = by_span(h)[whole], by_span(middle[:, joint])[whole]
    # the rates are evenly spaced, and exp(i (a + b)) is exp(i a) exp(i b): a few coarse and a few
    # fine waves give all
    fine = np.arange(np.ceil(np.sqrt(len(rates)))) * (rates[1] - rates[0])
    coarse, offset = (_waves(place, some) for some in (rates[:: len(fine)], fine))
    products = (coarse * h[..., None]).transpose(0, 2, 1) @ offset
    waves = products.reshape(len(h), coarse.shape[2] * len(fine))[:, : len(rates)]

    def summed(x: Array) -> Array:
        return np.asarray(np.einsum("ks,ks...->k...", h, by_span(x)[whole]))

    return summed(own), np.concatenate([waves.imag, waves.real], axis=1), summed(missing)


def _waves(place: Array, rates: Array) -> NDArray[np.complex128]:
    """Waves of some rates at places `(spans, samples)`: cosines, and as the imaginary part sines,
    `(spans, samples, rates)`."""
    return np.asarray(np.exp(place[..., None] * (2j * np.pi * rates)))


@singledispatch
def _family_numbers(_: Dynamics, plant: Plant, sizes: Array) -> list[float]:
    """The numbers of a family among what was regressed; none of a robot or a simulator, of which
    some may stay as declared."""
    return []


@_family_numbers.register
def _numbers_of_family(_: CompiledFamily, plant: Plant, sizes: Array) -> list[float]:
    return list(sizes[: len(plant.parameters)])


def _terms(plant: Plant, joint: int, states: Array, a: Array, u: Array) -> tuple[Array, Array]:
    """The form's own terms `(rows, terms)`, with a constant force and dry friction, and the
    acceleration that they have to make up `(rows,)`.

    Of a robot both are forces in units of the joint's inertia, and the drive is as strong as
    declared, for it measures all else.
    """
    joints = len(plant.joints)
    q, v = states[:, :joints], states[:, joints:]
    own, missing = _own_terms(plant.dynamics, plant, joint, (q, v, a, u))
    return np.column_stack([own, np.ones(len(q)), np.sign(v[:, joint])]), missing


Motion = tuple[Array, Array, Array, Array]  # q, v, a, u, `(rows, joints)` each


@singledispatch
def _own_terms(_: Dynamics, plant: Plant, joint: int, motion: Motion) -> tuple[Array, Array]:
    """The form's own terms at a joint `(rows, terms)`, and what they have to make up `(rows,)`."""
    shows, _force = columns(plant, *motion)
    missing = shows[:, joint] @ np.array(plant.parameters) - plant.form.tree[joint, OFFSET]
    gain = LINK * len(plant.joints) + JOINT * joint + GAIN
    return np.delete(shows[:, joint], gain, axis=1), missing / plant.form.sizes[joint]


@_own_terms.register
def _own_terms_of_family(
    dynamics: CompiledFamily, plant: Plant, joint: int, motion: Motion
) -> tuple[Array, Array]:
    q, v, a, u = motion
    return np.column_stack(dynamics.family.regressors(q[:, 0], v[:, 0], u[:, 0])), a[:, 0]


@_own_terms.register
def _own_terms_of_simulator(
    dynamics: SimulatedDynamics, plant: Plant, joint: int, motion: Motion
) -> tuple[Array, Array]:
    """Of several joints both are forces in units of the joint's inertia: only there does a force at
    a joint show at that joint alone."""
    q, v, a, u = motion
    numbers, states = np.array(plant.parameters), np.column_stack([q, v])
    slopes = dynamics.slopes(numbers, states, u)
    missing = a - dynamics.acceleration(numbers, states, u) + slopes @ numbers
    at_joint = dynamics.inertia(numbers, q)[:, joint]
    return np.einsum("nj,njp->np", at_joint, slopes), np.einsum("nj,nj->n", at_joint, missing)
