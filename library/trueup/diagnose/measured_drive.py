"""Measured drive: what a logged effort says of the drive by itself, whatever the joint then felt.

Many drives log a torque, mostly from the motor's current. Where it follows the command, it shows
the drive's gain in each direction and at each size, without any model of the machine. An effect of
the drive that it does not have is not sought at that joint: what looks like it came from behind the
drive. An effort that is the command again, to the last digit, says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.diagnose.tuning_of_answers import DRIVE
from trueup.episode.episode import Episode
from trueup.fit.rollout_fit import TWO_SIDED
from trueup.model.block import term
from trueup.model.plant import Plant

Array = NDArray[np.float64]
ECHO = 1e-6  # of an effort: a smaller rest is rounding
# effects of the drive that the columns |u| and u |u| beside u show, as parts of the gain
BY_DIRECTION, BY_SIZE = "gain_asymmetry", "quadratic_gain"


@dataclass(frozen=True, slots=True)
class MeasuredDrive:
    """What the effort at a joint says of its drive.

    effort = gain x (command, `late_s` [s] before), with the correlation of the two; by how much of
    itself the gain differs `by_direction` and `by_size` of the command, and at most so, at 95 %.
    """

    joint: int
    name: str
    gain: float
    late_s: float
    correlation: float
    by_direction: float
    by_size: float

    @property
    def denied(self) -> tuple[str, ...]:
        """Terms of effects that the drive does not have."""
        parts = {BY_DIRECTION: self.by_direction, BY_SIZE: self.by_size}
        return tuple(term(e, self.joint) for e, part in parts.items() if part < DRIVE.denied)

    def document(self) -> Json:
        """The drive as JSON, an entry of the report's evidence."""
        parts = {BY_DIRECTION: self.by_direction, BY_SIZE: self.by_size}
        return {
            "joint": self.name,
            "gain": self.gain,
            "late_s": self.late_s,
            "correlation": self.correlation,
            "denies": [
                {"effect": effect, "below": part, "confidence": 0.95}
                for effect, part in parts.items()
                if part < DRIVE.denied
            ],
        }


def measured_drives(plant: Plant, episodes: Sequence[Episode]) -> list[MeasuredDrive]:
    """The drives of joints whose logged efforts follow their commands, in the joints' order."""
    by_joint = (_measured_drive(plant, episodes, joint) for joint in range(len(plant.joints)))
    return [d for d in by_joint if d is not None]


def _measured_drive(plant: Plant, episodes: Sequence[Episode], joint: int) -> MeasuredDrive | None:
    column = int(plant.command_columns[joint])
    logged = [
        e for e in episodes if e.effort is not None and np.isfinite(e.effort[:, column]).any()
    ]
    if column < 0 or not logged:
        return None
    period_s = float(np.median([e.period_s for e in logged]))
    pairs = [
        (e.effort[:, column], e.within_limits[:, column]) for e in logged if e.effort is not None
    ]
    lags = range(round(DRIVE.latest_s / period_s) + 1)
    lag = max(lags, key=lambda k: _correlation(pairs, k))
    correlation = _correlation(pairs, lag)
    if correlation < DRIVE.follows:
        return None
    effort, command = _late(pairs, lag)
    largest = float(np.max(np.abs(command))) or 1.0
    u = command / largest
    design = np.stack([u, np.abs(u), u * np.abs(u), np.ones_like(u)], axis=1)
    solved, *_ = np.linalg.lstsq(design, effort, rcond=None)
    left = effort - design @ solved
    if float(np.std(left)) < ECHO * float(np.std(effort)):
        return None
    errors = _errors(design, left)
    gain = float(solved[0])
    by_direction, by_size = (
        (abs(float(solved[i])) + TWO_SIDED * float(errors[i])) / max(abs(gain), 1e-300)
        for i in (1, 2)
    )
    return MeasuredDrive(
        joint,
        plant.joint_name(joint),
        gain / largest,
        lag * period_s,
        correlation,
        by_direction,
        by_size,
    )


def _late(pairs: Sequence[tuple[Array, Array]], lag: int) -> tuple[Array, Array]:
    """Efforts, and the commands so many samples before them."""
    efforts = np.concatenate([e[lag:] for e, _ in pairs])
    commands = np.concatenate([u[: len(u) - lag] for _, u in pairs])
    known = np.isfinite(efforts) & np.isfinite(commands)
    return efforts[known], commands[known]


def _correlation(pairs: Sequence[tuple[Array, Array]], lag: int) -> float:
    """How closely efforts follow commands so many samples before them; 0 where nothing moves."""
    effort, command = _late(pairs, lag)
    spread = float(np.std(effort) * np.std(command)) if len(effort) else 0.0
    if not spread > 0.0:
        return 0.0
    centred = (effort - effort.mean()) * (command - command.mean())
    return abs(float(centred.mean())) / spread


def _errors(design: Array, left: Array) -> Array:
    """Standard errors of coefficients whose rest is correlated from sample to sample, by means over
    blocks."""
    inverse = np.linalg.inv(design.T @ design)
    blocks = np.array_split(design * left[:, None], DRIVE.blocks)
    scores = np.array([b.sum(axis=0) for b in blocks])
    moved = scores @ inverse
    return np.asarray(np.sqrt((moved**2).sum(axis=0)))
