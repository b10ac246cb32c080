"""Bounds on an excitation: of command, rate, travel, speed, band and time.

Travel is bounded by the envelope that plant.json declares, and where it declares none, by the
recorded ranges; speed and the rate of a command by what was recorded, unless they are given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.errors import BadPlant, NotIdentifiable
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
SMOOTHED = 0.85  # of a random excitation, from sample to sample: at 0.05 s the chapter's
# where a bound comes from
DECLARED, RECORDED, GIVEN, BAND, UNBOUNDED = ("declared", "recorded", "given", "band", "unbounded")
LONGEST_S = 3600.0  # of an excitation


@dataclass(frozen=True, slots=True)
class Recorded:
    """The range of a machine's recorded motion: `ranges` `(2 x joints, 2)` of positions and
    velocities, nan where not observed, and `rate` `(joints,)`, the fastest change of each command
    [command/s].

    Velocities are bounded alike in both directions.
    """

    ranges: Array
    rate: Array

    @staticmethod
    def of(plant: Plant, episodes: Sequence[Episode]) -> Recorded:
        """The range of motion in recordings, of which there may be none."""
        joints = len(plant.joints)
        ranges, rate = np.full((2 * joints, 2), np.nan), np.full(joints, np.nan)
        for episode in episodes:
            states, command = smoothed_states(plant, episode), plant.applied(episode.commands)
            states[:, joints:] = np.abs(states[:, joints:])
            ranges[:, 0] = np.fmin(ranges[:, 0], np.fmin.reduce(states, axis=0))
            ranges[:, 1] = np.fmax(ranges[:, 1], np.fmax.reduce(states, axis=0))
            steps = np.abs(np.diff(command, axis=0)) / np.diff(episode.t_s[: len(command)])[:, None]
            rate = np.fmax(rate, steps.max(axis=0, initial=0.0))
        ranges[joints:, 0] = -ranges[joints:, 1]
        return Recorded(ranges, rate)


@dataclass(frozen=True, slots=True)
class Bounds:
    """The bounds on an excitation: `low` and `high` of the command `(joints,)`, `rate` [command/s]
    `(joints,)`, `envelope` `(2 x joints, 2)` of positions and velocities less its `margin`,
    `band_hz`, `duration_s` [s] without the hold at the end.

    `sources` `(2 x joints,)` says where each row of the envelope comes from, `rate_sources`
    `(joints,)` where each rate does.
    """

    low: Array
    high: Array
    rate: Array
    envelope: Array
    margin: float
    band_hz: tuple[float, float]
    duration_s: float
    sources: tuple[str, ...]
    rate_sources: tuple[str, ...]

    @staticmethod
    def of(
        plant: Plant,
        duration_s: float,
        band_hz: tuple[float, float] | None = None,
        rate: float | None = None,
        margin: float = 0.1,
        *,
        speed: float | None = None,
        recorded: Recorded | None = None,
    ) -> Bounds:
        """The plant's declared bounds, and where it declares none, those of its `recorded` motion.

        No command crosses its range faster than in a fifth of the band's shortest period. Raises
        BadPlant, and NotIdentifiable where nothing bounds the travel of a joint.
        """
        if not 0.0 <= margin < 1.0 or not 0.0 < duration_s <= LONGEST_S:
            raise BadPlant(
                (
                    "an excitation needs a margin from 0 to below 1, and a duration above 0 and "
                    "of an hour at most"
                ),
                field="margin",
            )
        if not all(given is None or given > 0.0 for given in (rate, speed)):
            raise BadPlant("a rate and a speed are positive", field="rate")
        joints = len(plant.joints)
        low, high = (
            np.where(plant.command_columns >= 0, bound[plant.command_columns], 0.0)
            for bound in plant.limits
        )
        band = band_hz or (1.0 / duration_s, min(0.1 / plant.timestep_s, 20.0 / duration_s))
        been = Recorded.of(plant, []) if recorded is None else recorded
        ranges, sources = _ranges(plant, been, speed)
        if len(free := np.flatnonzero(~_bounded(ranges[:joints]))):
            raise NotIdentifiable(
                (
                    "nothing says how far "
                    f"{' and '.join(plant.joint_name(int(j)) for j in free)} may travel"
                ),
                hint=(
                    "Declare the range under envelope in plant.json, or put an adaptation "
                    "recording into the case folder."
                ),
            )
        envelope = _widened(ranges, 1.0 - margin)
        fastest = 5.0 * band[1] * np.maximum(high - low, 1e-12)
        if rate is not None:
            rates, rate_sources = np.full(joints, rate), (GIVEN,) * joints
        else:
            rates = np.fmin(been.rate, fastest)
            rate_sources = tuple(
                RECORDED if recorded_binds else BAND for recorded_binds in been.rate <= fastest
            )
        return Bounds(low, high, rates, envelope, margin, band, duration_s, sources, rate_sources)

    def inside(self, paths: Array) -> bool:
        """Whether every path `(…, samples, 2 x joints)` keeps the envelope less its margin."""
        low, high = self.envelope.T
        return bool(((paths >= low) & (paths <= high)).all())

    def used(self, paths: Array, start: Array) -> float:
        """The largest part of the room between a state `start` `(2 x joints,)` and the envelope
        less its margin that paths `(members, samples, 2 x joints)` take. Above 1, a path leaves
        it."""
        low, high = self.envelope.T
        with np.errstate(invalid="ignore", divide="ignore"):
            parts = [
                (paths - start).max(axis=(0, 1)) / (high - start),
                (start - paths).max(axis=(0, 1)) / (start - low),
            ]
        most = float(np.max(np.nan_to_num(parts, nan=np.inf, posinf=np.inf, neginf=np.inf)))
        return most if np.isfinite(paths).all() else np.inf

    def room(self, state: Array) -> float:
        """How far a state `(2 x joints,)` is from the nearest end of the envelope, as a part of
        half its width; negative outside of it."""
        bounded = _bounded(self.envelope)
        (low, high), within = self.envelope[bounded].T, state[bounded]
        return float(
            (np.minimum(within - low, high - within) / np.maximum((high - low) / 2.0, 1e-300)).min(
                initial=1.0
            )
        )

    def whole(self) -> Array:
        """The envelope without its margin, `(2 x joints, 2)`."""
        return _widened(self.envelope, 1.0 / (1.0 - self.margin))

    def random(self, hold: Array, like: Array, rng: np.random.Generator) -> Array:
        """Smoothed noise about a command `hold` `(joints,)`, with the energy of the command `like`
        `(samples, joints)`, within the limits."""
        x = np.zeros_like(like)
        for i in range(1, len(x)):
            x[i] = SMOOTHED * x[i - 1] + (1.0 - SMOOTHED) * rng.standard_normal(x.shape[1])
        energy, size = np.sum((like - hold) ** 2), 1.0
        for _ in range(4):  # cutting off takes some of it
            cut = np.clip(hold + size * x, self.low, self.high)
            size *= float(np.sqrt(energy / max(np.sum((cut - hold) ** 2), 1e-300)))
        return np.clip(hold + size * x, self.low, self.high)


def _bounded(ranges: Array) -> NDArray[np.bool_]:
    """Which of some ranges `(n, 2)` are finite, `(n,)`."""
    return np.asarray(np.isfinite(ranges).all(axis=1))


def _widened(ranges: Array, by: float) -> Array:
    """Ranges `(n, 2)` widened about their middles by a factor; an unbounded range stays
    unbounded."""
    bounded = _bounded(ranges)[:, None]
    kept = np.where(bounded, ranges, 0.0)
    middle, half = kept.mean(axis=1, keepdims=True), by * np.diff(kept, axis=1) / 2.0
    return np.where(
        bounded, np.concatenate([middle - half, middle + half], axis=1), [-np.inf, np.inf]
    )


def _ranges(plant: Plant, been: Recorded, speed: float | None) -> tuple[Array, tuple[str, ...]]:
    """The range of each position and velocity `(2 x joints, 2)`, infinite where nothing bounds it,
    and where it comes from."""
    joints, known = len(plant.joints), _bounded(been.ranges)
    ranges = np.where(known[:, None], been.ranges, [-np.inf, np.inf])
    sources = [RECORDED if is_known else UNBOUNDED for is_known in known]
    for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
        if channel.name in plant.envelope:
            declared = np.array(plant.envelope[channel.name])
            if sources[column] == DECLARED:  # two sensors of one motion: it keeps within both
                declared = np.array(
                    [max(declared[0], ranges[column][0]), min(declared[1], ranges[column][1])]
                )
            if not declared[0] < declared[1]:
                raise NotIdentifiable(
                    f"the ranges of {channel.name} and of another channel of the same motion "
                    "have nothing in common"
                )
            ranges[column], sources[column] = declared, DECLARED
    if speed is not None:
        for column in range(joints, 2 * joints):
            low, high = ranges[column] if sources[column] == DECLARED else (-np.inf, np.inf)
            if low < -speed or high > speed:
                ranges[column], sources[column] = (max(low, -speed), min(high, speed)), GIVEN
    return ranges, tuple(sources)
