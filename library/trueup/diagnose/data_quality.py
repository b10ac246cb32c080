"""Data quality: what the episodes are like before anything is fitted: noise, quantization,
repeated frames, sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.noise import noise_of
from trueup.diagnose.tuning import DATA_QUALITY
from trueup.episode.episode import Episode
from trueup.errors import NotIdentifiable
from trueup.model.hypothesis import Scales
from trueup.model.plant import Plant
from trueup.model.series import held_frames, positions_and_velocities
from trueup.model.sizes import sizes
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
DIFFERENCE = 4  # order, of what tells the noise
# a quantizer's step over the standard deviation of its rounding
ROUNDING = np.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class DataQuality:
    """Sizes of one set of episodes.

    `noise`, `sigma` and `motion` `(2 x joints,)`: standard deviation of the noise, of what fits
    count as noise, and of the motion, of positions and velocities, nan where not observed;
    `correlation` that of the noise with itself one sample before. `lattice` `(2 x joints,)`: steps
    on which their values lie, 0 where on none. `held` `(joints,)` is the fraction of repeated
    frames, `scales` the joints' own sizes.
    """

    noise: Array
    sigma: Array
    correlation: Array
    motion: Array
    lattice: Array
    held: Array
    scales: tuple[Scales, ...]

    @property
    def observed(self) -> NDArray[np.bool_]:
        """Which of positions and velocities there are."""
        return np.isfinite(self.sigma)

    @property
    def coarse(self) -> NDArray[np.bool_]:
        """Which of them are quantized enough to make a gap."""
        return np.asarray(
            self.lattice / ROUNDING > DATA_QUALITY.coarse * np.nan_to_num(self.motion, nan=np.inf)
        )

    def of_joint(self, joint: int) -> NDArray[np.int64]:
        """Where a joint's position and velocity stand."""
        return np.array([joint, len(self.scales) + joint])

    def lattices(self, joint: int) -> tuple[Array, NDArray[np.bool_]]:
        """Steps of a joint's position and velocity, and whether they make a gap."""
        at = self.of_joint(joint)
        return self.lattice[at], self.coarse[at]


def assess(plant: Plant, episodes: Sequence[Episode]) -> DataQuality:
    """The quality of adaptation episodes. Raises NotIdentifiable where nothing moves, or no command
    was given."""
    if not episodes:
        raise NotIdentifiable(
            "there is no adaptation episode to fit",
            hint="Give episodes the role adaptation, and others validation.",
        )
    joints = len(plant.joints)
    noise, sigma, motion = (np.full(2 * joints, np.nan) for _ in range(3))
    lattice, correlation = np.zeros(2 * joints), np.zeros(2 * joints)
    repeats = [held_frames(positions_and_velocities(plant, e), e.t_s) for e in episodes]
    for channel, column in enumerate(plant.state_columns):
        tracks = [
            e.observations[:, channel][~r[:, column]]
            for e, r in zip(episodes, repeats, strict=True)
        ]
        tracks = [x[np.isfinite(x)] for x in tracks if np.isfinite(x).sum() > 2 * DIFFERENCE]
        if tracks:
            lattice[column] = _lattice(np.concatenate(tracks))
            motion[column] = float(np.std(np.concatenate([x - x.mean() for x in tracks])))
            whole = [
                (e.observations[:, channel], r[:, column])
                for e, r in zip(episodes, repeats, strict=True)
            ]
            of_channel = noise_of(whole)
            noise[column] = max(of_channel.sigma, lattice[column] / ROUNDING)
            sigma[column] = max(noise[column], DATA_QUALITY.numerical_floor * motion[column])
            if (
                not lattice[column]
                and noise[column] >= DATA_QUALITY.numerical_floor * motion[column]
            ):  # else it is the sensor's step, or the integration's
                correlation[column] = of_channel.correlation
    states = np.concatenate([smoothed_states(plant, e) for e in episodes])
    issued = np.concatenate([plant.applied(e.commands) for e in episodes])
    held = np.mean(np.concatenate(repeats)[:, :joints], axis=0)
    return DataQuality(
        noise,
        sigma,
        correlation,
        motion,
        lattice,
        held,
        tuple(sizes(plant, j, states, issued) for j in range(joints)),
    )


def _lattice(values: Array) -> float:
    """The step of the lattice on which all values lie, 0 where there is none."""
    distinct = np.unique(values)
    if len(distinct) < 3 or len(distinct) > DATA_QUALITY.lattice_values * len(values):  # noqa: PLR2004  (three values make two steps)
        return 0.0
    gaps = np.diff(distinct)
    gaps = gaps[gaps > 1e-9 * (distinct[-1] - distinct[0])]
    step = float(gaps.min())
    counts = np.rint(gaps / step)
    step = float(gaps.sum() / counts.sum())
    return step if float(np.abs(gaps / step - counts).max()) < DATA_QUALITY.lattice_fit else 0.0
