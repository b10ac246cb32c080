"""Regions: the named parts of a joint's motion and commands in which effects show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.tuning_of_answers import EVIDENCE
from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
SLOW = 0.1  # of the top speed
LARGE = 0.8  # of the largest command or travel
LATE = 2.0 / 3.0  # of the episode


def regions(
    q: Array, v: Array, u: Array, late: Array, use: Array, turned: NDArray[np.bool_]
) -> dict[str, NDArray[np.bool_]]:
    """Which of some moments are in which region: position, speed and command, the part of the
    episode that has passed, the mean square of the command until then, and whether the joint turns,
    `(moments,)` each.
    """
    return {
        "near zero speed": np.abs(v) < SLOW * np.quantile(np.abs(v), 0.99),
        "at reversals": turned,
        "beyond 80 % of the largest command": np.abs(u) > LARGE * np.abs(u).max(),
        "small commands": np.abs(u) < SLOW * 2.0 * np.abs(u).max(),
        "upper end of travel": q > LARGE * q.max(),
        "lower end of travel": q < LARGE * q.min(),
        "fast motion": np.abs(v) > LARGE * np.quantile(np.abs(v), 0.99),
        "late in the episode": late > LATE,
        "after heavy use": use > np.quantile(use, 0.75),
    }


def used(applied: Array, episode: Episode) -> Array:
    """Mean square of what was applied `(samples, joints)` from the episode's beginning to each
    sample."""
    zero = np.zeros((1, applied.shape[1]))
    summed = np.concatenate(
        [zero, np.cumsum(applied[:-1] ** 2 * np.diff(episode.t_s)[:, None], axis=0)]
    )
    return np.asarray(summed / np.maximum(episode.t_s, episode.period_s)[:, None])


def regions_of_samples(plant: Plant, episode: Episode) -> dict[str, NDArray[np.bool_]]:
    """Which samples of an episode are in which region of which joint, and outside the declared
    envelope, `(samples,)` each."""
    states, applied, count = (
        smoothed_states(plant, episode),
        plant.applied(episode.commands),
        len(plant.joints),
    )
    use, around = (
        used(applied, episode),
        max(1, round(EVIDENCE.around_reversal_s / episode.period_s / 2.0)),
    )
    inside_of: dict[str, NDArray[np.bool_]] = {}
    for joint in range(count):
        q, v = states[:, joint], states[:, count + joint]
        crossed = np.concatenate([[0.0], (v[:-1] * v[1:] < 0.0).astype(float)])
        turned = np.convolve(crossed, np.ones(2 * around + 1), "same") > 0.0
        of = regions(
            q, v, applied[:, joint], episode.t_s / episode.t_s[-1], use[:, joint], turned[: len(q)]
        )
        inside_of |= {
            f"{plant.joint_name(joint)}: {name}" if count > 1 else name: inside
            for name, inside in of.items()
        }
    outside = np.zeros(len(episode.t_s), np.bool_)
    for column, channel in enumerate(plant.layout.observations):
        low, high = plant.envelope.get(channel.name, (-np.inf, np.inf))
        outside |= (episode.observations[:, column] < low) | (
            episode.observations[:, column] > high
        )
    return inside_of | {"outside the envelope": outside}
