"""Log: a plant with its recordings, as the doctor looks at them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trueup.doctor.balance import Balance, balances
from trueup.doctor.kinematics import Kinematics, kinematics
from trueup.doctor.mends import Mend
from trueup.episode.episode import Episode
from trueup.episode.layout import Channel
from trueup.model.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Log:
    """A plant and its episodes."""

    plant: Plant
    episodes: Sequence[Episode]

    def mended(self, mends: Sequence[Mend]) -> Log:
        """The log with some mends applied."""
        episodes = list(self.episodes)
        for mend in mends:
            episodes = mend.applied_to(episodes)
        return replace(self, episodes=episodes)

    @cached_property
    def digests(self) -> tuple[str, ...]:
        """The digests of all recordings."""
        return tuple(e.digest for e in self.episodes)

    @cached_property
    def balances(self) -> list[Balance | None]:
        """For each joint, how well the nominal model's form explains the log."""
        return balances(self.plant, self.episodes)

    @cached_property
    def kinematics(self) -> list[Kinematics | None]:
        """For each joint, how its logged velocity lies against its position."""
        every = range(len(self.plant.joints))
        return [kinematics(self.plant, self.episodes, joint) for joint in every]

    def joint(self, joint: int) -> str | None:
        """A joint's name, None where the plant gives it none."""
        return self.plant.joints[joint]

    def observation(self, column: int) -> int | None:
        """The column of the observations that shows a column of the state, None where none does."""
        at = np.flatnonzero(self.plant.state_columns == column)
        return int(at[0]) if len(at) else None

    def position(self, joint: int) -> int | None:
        """The column of a joint's position in the observations."""
        return self.observation(joint)

    def velocity(self, joint: int) -> int | None:
        """The column of a joint's velocity in the observations, None where it is not logged."""
        at = self.observation(len(self.plant.joints) + joint)
        if at is None or all(np.isnan(e.observations[:, at]).all() for e in self.episodes):
            return None
        return at

    def command(self, joint: int) -> int | None:
        """The column of a joint's command, None where it has none."""
        at = int(self.plant.command_columns[joint])
        return at if at >= 0 else None

    def observed(self, at: int) -> Channel:
        """A channel of the observations."""
        return self.plant.layout.observations[at]

    def issued(self, at: int) -> Channel:
        """A channel of the commands."""
        return self.plant.layout.commands[at]

    def commands(self, at: int) -> Array:
        """All values of a command."""
        return np.concatenate([e.commands[:, at] for e in self.episodes])

    def values(self, at: int) -> Array:
        """All values of an observation that are numbers."""
        values = np.concatenate([e.observations[:, at] for e in self.episodes])
        return np.asarray(values[np.isfinite(values)])

    def beyond_limits(self, at: int, times: float = 1.0) -> float:
        """The part of a command's samples that lie outside so many times its limits."""
        limits = self.issued(at).limits
        if limits is None:
            return 0.0
        low, high = limits
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        return float(np.mean(np.abs(self.commands(at) - middle) > times * half))

    def beyond_envelope(self, at: int, times: float = 1.0) -> float:
        """The part of an observation's samples that lie outside so many times its envelope."""
        declared = self.plant.envelope.get(self.observed(at).name)
        if declared is None:
            return 0.0
        low, high = declared
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        values = self.values(at)
        return float(np.mean(np.abs(values - middle) > times * half)) if len(values) else 0.0
