"""Random-shooting planner: try many command sequences on the predictor, apply the first command of the cheapest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.model.predictor import Predictor

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RandomShooting:
    """Plans `sequences` of `steps` commands, uniform within ± `u_max`, each held for `hold` steps of the predictor.

    Cost: sum over the steps of (position after the step - reference)^2 + effort x u^2, the reference held.
    Source: A. Rao, A Survey of Numerical Methods for Optimal Control (2009), section on shooting; here without refinement.
    """

    predictor: Predictor
    u_max: float
    sequences: int = 64
    steps: int = 8
    effort: float = 0.02
    hold: int = 1  # steps of the predictor under each command

    def plan(self, state: Array, reference: float, rng: np.random.Generator) -> Array:
        """The issued command `(1,)` for a state `(states,)`."""
        commands = rng.uniform(-self.u_max, self.u_max, size=(self.sequences, self.steps))
        states = np.repeat(state[None, :], self.sequences, axis=0)
        cost = np.zeros(self.sequences)
        for i in range(self.steps):
            issued = commands[:, i]
            for _ in range(self.hold):
                states = self.predictor.predict_batch(states, issued[:, None])
            cost += (states[:, 0] - reference) ** 2 + self.effort * issued**2
        return commands[np.argmin(cost), :1]
