"""Courses: the references that a machine is asked to follow, no larger and no faster than it has
moved, and the planner that follows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.control.planner import Linearised, Planner, RandomShooting
from trueup.episode.episode import Episode
from trueup.errors import NotIdentifiable
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
TICKS = 200
TICKS_A_HORIZON = 40
TURNS = (0.15, 0.3, 0.6)  # of the reference in a horizon: the chapter's is the middle one
SHARE = 0.6  # of the envelope, or of the travel that was recorded
# of the squared amplitude, for the whole command: the chapter's 0.02 at its amplitude of 0.55
EFFORT = 0.066
FAST = 0.99  # of the recorded speeds are no higher than the highest: one glitch is none
MOVED = 20.0  # times what noise moves a joint
BEGINS = 0.2  # of the amplitude: where a robot's joints begin


@dataclass(frozen=True)
class Travelled:
    """How far each joint has been recorded, `low` and `high` `(joints,)`, how fast, `speed`
    `(joints,)`, and which of them `moved`."""

    low: Array
    high: Array
    speed: Array
    moved: NDArray[np.bool_]

    @staticmethod
    def of(plant: Plant, episodes: Sequence[Episode]) -> Travelled:
        """The travel in recordings. A single joint may go as far to either side."""
        joints = len(plant.joints)
        states = np.concatenate([smoothed_states(plant, e) for e in episodes])
        positions, speed = (
            states[:, :joints],
            np.nanquantile(np.abs(states[:, joints:]), FAST, axis=0),
        )
        if joints == 1:
            far = np.nanmax(np.abs(positions), axis=0)
            return Travelled(-far, far, speed, np.ones(1, np.bool_))
        low, high = np.nanmin(positions, axis=0), np.nanmax(positions, axis=0)
        # what noise alone moves from sample to sample
        shakes = np.nanstd(np.diff(positions, n=2, axis=0), axis=0)
        return Travelled(low, high, speed, (high > low) & (high - low > MOVED * shakes))


@dataclass(frozen=True)
class Courses:
    """Sine waves about a `middle`, with an `amplitude` and, for tracking errors and planners, a
    `scale` of each joint, `(joints,)` each; one of each of the frequencies [Hz].

    A tick is `hold` steps of the plant; a course lasts `ticks` of them. `effort` is the cost of a
    squared command, in squares of a single joint's position; None is a share of its amplitude.
    """

    plant: Plant
    middle: Array
    amplitude: Array
    scale: Array
    frequencies_hz: tuple[float, ...]
    hold: int
    ticks: int
    effort: float | None = None

    @staticmethod
    def within(
        plant: Plant, travelled: Travelled, ticks: int | None = None, effort: float | None = None
    ) -> Courses:
        """Three courses within the recorded ranges and the envelope, the fastest of a robot no
        faster than it moved. Raises NotIdentifiable where no joint moved, or one takes no
        command."""
        _require_commanded(plant)
        if not travelled.moved.any():
            raise NotIdentifiable(
                "no joint of the robot moved", hint="Hold out an episode in which the joints move."
            )
        low, high = _allowed(plant, travelled)
        middle, amplitude = (
            (low + high) / 2.0,
            SHARE * np.where(travelled.moved, (high - low) / 2.0, 0.0),
        )
        # what never moved is held still
        scale = np.where(travelled.moved, amplitude, amplitude[travelled.moved].mean())
        fastest = 1.0
        if len(plant.joints) > 1:
            moved = travelled.moved
            slowest_hz = float(np.min(travelled.speed[moved] / (2.0 * np.pi * amplitude[moved])))
            fastest = min(1.0, slowest_hz * plant.horizon_s / TURNS[-1])
        hz = tuple(fastest * turns / plant.horizon_s for turns in TURNS)
        hold = tick_of(plant)
        return Courses(plant, middle, amplitude, scale, hz, hold, ticks or TICKS, effort)

    @staticmethod
    def declared(
        plant: Plant, amplitude: float, frequency_hz: float, ticks: int, effort: float | None
    ) -> Courses:
        """One course of a single joint about zero, as somebody declares it: amplitude in units of
        its position. Raises NotIdentifiable for a robot."""
        _require_commanded(plant)
        if len(plant.joints) > 1:
            raise NotIdentifiable(
                "a reference of one amplitude is for a single joint",
                hint="Leave the reference out: a robot's follow the recorded travel.",
            )
        size = np.array([amplitude])
        return Courses(
            plant, np.zeros(1), size, size, (frequency_hz,), tick_of(plant), ticks, effort
        )

    @property
    def tick_s(self) -> float:
        """The time between two commands [s]."""
        return self.hold * self.plant.timestep_s

    def reference(self, frequency_hz: float) -> Array:
        """The positions wanted at each tick, `(ticks, joints)`."""
        t_s = np.arange(self.ticks) * self.hold * self.plant.timestep_s
        wave = np.sin(2.0 * np.pi * frequency_hz * t_s)
        return np.asarray(self.middle + self.amplitude * wave[:, None])

    def begin(self, rng: np.random.Generator) -> Array:
        """The state `(states,)` to begin from: rest, of a robot near the middle, where chance says,
        for its planner does not draw."""
        joints = len(self.plant.joints)
        state = np.zeros(2 * joints)
        if joints > 1:
            state[:joints] = self.middle + BEGINS * self.amplitude * rng.uniform(-1.0, 1.0, joints)
        return state

    def planner(self, model: Predictor, authority: float = 1.0) -> Planner:
        """The fixed planner with a model: random shooting for one joint, else by derivatives."""
        if len(self.scale) > 1:
            scales = tuple(map(float, self.scale))
            return Linearised(model, scales, hold=self.hold, authority=authority)
        low, high = self.plant.limits
        half = float(high[0] - low[0]) / 2.0
        effort = EFFORT * float(self.scale[0]) ** 2 / half**2
        return RandomShooting(
            model, authority, effort=effort if self.effort is None else self.effort, hold=self.hold
        )

    @property
    def error_scale(self) -> Array:
        """What tracking errors are divided by before they are squared: nothing for one joint, for a
        robot each joint's scale, `(joints,)`."""
        return np.ones(1) if len(self.scale) == 1 else self.scale


def tick_of(plant: Plant) -> int:
    """Steps of a plant in a tick of its controller."""
    return max(1, round(plant.horizon_s / TICKS_A_HORIZON / plant.timestep_s))


def _require_commanded(plant: Plant) -> None:
    if (plant.command_columns < 0).any():
        raise NotIdentifiable(
            "a joint without a command cannot follow anything",
            hint="Leave closed-loop rules out of this plant's gates.",
        )


def _allowed(plant: Plant, travelled: Travelled) -> tuple[Array, Array]:
    """The range of each joint's references, `(joints,)` each: the envelope, and for a robot also
    the recorded range."""
    low, high = travelled.low.copy(), travelled.high.copy()
    for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
        if column < len(plant.joints) and channel.name in plant.envelope:
            near, far = plant.envelope[channel.name]
            one = len(plant.joints) == 1
            low[column], high[column] = (
                (near, far) if one else (max(near, low[column]), min(far, high[column]))
            )
    return low, high
