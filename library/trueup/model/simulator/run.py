"""A series laid out for the rollout of a simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.model.series import Series
from trueup.model.simulator.step import Memory, SimulatedStep
from trueup.model.simulator.timeline import Acting, Timeline

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A series with everything that its rollout needs, by windows; so many lanes behind the first
    are `following` it, and begin each window with what it remembers. Its lane 0 is a filter's where
    there is a gain."""

    series: Series
    timeline: Timeline
    step: SimulatedStep
    sensors: Sequence[Acting]
    late_s: Array  # `(joints, lanes)`, by which sensors are late
    commands: Array  # `(steps, joints, lanes)`
    h_s: Array
    init: Array  # `(windows, 2 x joints, lanes)`
    following: int
    gain: Array | None

    @property
    def lanes(self) -> int:
        """How many simulations there are of each window."""
        return int(self.init.shape[2])

    @property
    def ends(self) -> NDArray[np.int64]:
        """The sample behind each window."""
        return np.append(self.timeline.starts[1:], len(self.series.t_s) - 1)

    def begin(self) -> tuple[Array, Memory]:
        """The hidden states of the simulator `(lanes, hidden)` and of effects before the log."""
        lanes = self.lanes
        hidden = np.tile(np.array(self.step.simulator.begins), (lanes, 1))
        memory: Memory = {}
        for one in self.step.forces:
            memory |= one.begin(self.series.issued[0, one.joint], lanes)
        return hidden, memory
