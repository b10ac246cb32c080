"""Planners that roll a predictor out and apply the first command of the cheapest: by chance for one joint, by derivatives for many."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.model.predictor import Predictor

Array = NDArray[np.float64]


NUDGES = (0.2, 0.05, 0.02)  # of a command's range, for derivatives: wide ones first, for dry friction hides narrow ones


class Planner(ABC):
    """Plans one command from a state; its `predictor` is the model that it believes."""

    predictor: Predictor

    @abstractmethod
    def plan(self, state: Array, reference: Array, rng: np.random.Generator) -> Array:
        """The issued command `(commands,)` for a state `(states,)`; `reference` `(ticks, joints)` is wanted after the coming ticks."""


@dataclass(frozen=True, slots=True)
class RandomShooting(Planner):
    """Plans `sequences` of `steps` commands, uniform within ± `u_max`, each held for `hold` steps of the predictor.

    Cost: sum over the steps of (position after the step - reference)^2 + effort x u^2, the reference held at that of the coming tick.
    Source: A. Rao, A Survey of Numerical Methods for Optimal Control (2009), section on shooting; here without refinement.
    """

    predictor: Predictor
    u_max: float
    sequences: int = 64
    steps: int = 8
    effort: float = 0.02
    hold: int = 1  # steps of the predictor under each command

    def plan(self, state: Array, reference: Array, rng: np.random.Generator) -> Array:
        commands = rng.uniform(-self.u_max, self.u_max, size=(self.sequences, self.steps))
        states = np.repeat(state[None, :], self.sequences, axis=0)
        cost = np.zeros(self.sequences)
        for i in range(self.steps):
            issued = commands[:, i]
            for _ in range(self.hold):
                states = self.predictor.predict_batch(states, issued[:, None])
            cost += (states[:, 0] - reference[0, 0]) ** 2 + self.effort * issued**2
        return commands[np.argmin(cost), :1]


@dataclass(frozen=True, slots=True)
class Linearised(Planner):
    """Plans the one command that, held over `steps` x `hold` steps of the predictor, brings every joint nearest to its coming references.

    Cost: sum over steps and joints of ((position - reference) / scale)^2 + effort x (command / its range)^2, by steps of
    Gauss and Newton on the predictor's differences, cut off at the limits; the best of them is issued.
    Source: the receding horizon of J. B. Rawlings, D. Q. Mayne, Model Predictive Control (2009), with one move.
    """

    predictor: Predictor
    scale: tuple[float, ...]
    steps: int = 8
    effort: float = 1e-4
    hold: int = 1

    def plan(self, state: Array, reference: Array, rng: np.random.Generator) -> Array:
        low, high = self.predictor.plant.limits
        reach, nudged = high - low, np.vstack([np.zeros(len(low)), np.eye(len(low))])
        wanted = reference[np.minimum(np.arange(self.steps), len(reference) - 1)] / self.scale
        about = best = np.clip(np.zeros(len(low)), low, high)
        least, penalty = np.inf, np.sqrt(self.effort) * np.eye(len(low))
        for nudge in (*NUDGES, 0.0):  # the last looks at what the one before it found
            commands = (about + nudge * reach * nudged) if nudge else about[None, :]
            positions = self._positions(np.repeat(state[None, :], len(commands), axis=0), commands)
            off = np.append((wanted - positions[0]).ravel(), penalty @ (-about / reach))
            if not np.isfinite(positions).all() or off @ off > least:
                break
            best, least = about, float(off @ off)
            if nudge:
                columns = np.vstack([((positions[1:] - positions[0]) / nudge).reshape(len(low), -1).T, penalty])
                about = np.clip(about + reach * np.linalg.lstsq(columns, off, rcond=None)[0], low, high)
        return np.asarray(best)

    def _positions(self, states: Array, commands: Array) -> Array:
        """Scaled positions `(rows, steps, joints)` under commands `(rows, commands)` that are held."""
        course = self.predictor.course(states, commands, self.steps * self.hold)
        return np.asarray(course[:, self.hold - 1 :: self.hold, : len(self.scale)] / self.scale)
