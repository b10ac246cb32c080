"""Planners that roll a predictor out and apply the first command of the cheapest: by chance for one
joint, by derivatives for many."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from trueup.model.predictor import Predictor

Array = NDArray[np.float64]


SHORTER = (1.0, 0.5, 0.2)  # of a step
# of a command's range, for derivatives: wide ones first, for dry friction hides narrow ones
NUDGES = (0.2, 0.05, 0.02)


class Planner(ABC):
    """Plans one command from a state; its `predictor` is the model that it plans with."""

    predictor: Predictor

    @abstractmethod
    def plan(self, state: Array, reference: Array, rng: np.random.Generator) -> Array:
        """The issued command `(commands,)` for a state `(states,)`; `reference` `(ticks, joints)`
        is wanted after the coming ticks."""


@dataclass(frozen=True, slots=True)
class RandomShooting(Planner):
    """Plans `sequences` of `steps` commands of one joint, uniform within a share `authority` of its
    limits, each held for `hold` steps of the predictor.

    Cost: sum over the steps of (position after the step - reference)^2 + effort x u^2, the
    reference held at that of the coming tick. Source: A. Rao, A Survey of Numerical Methods for
    Optimal Control (2009), section on shooting; here without refinement.
    """

    predictor: Predictor
    authority: float = 1.0
    sequences: int = 64
    steps: int = 8
    effort: float = 0.02
    hold: int = 1  # steps of the predictor under each command

    def plan(self, state: Array, reference: Array, rng: np.random.Generator) -> Array:
        low, high = (float(x[0]) for x in self.predictor.plant.limits_at(self.authority))
        commands = rng.uniform(low, high, size=(self.sequences, self.steps))
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
    """Plans the one command that, held over `steps` x `hold` steps of the predictor, brings every
    joint nearest to its coming references.

    Cost: sum over steps and joints of ((position - reference) / scale)^2 + effort x (command / its
    range)^2, by steps of Gauss and Newton on the predictor's differences, between the limits.
    Source: the receding horizon of J. B. Rawlings, D. Q. Mayne, Model Predictive Control (2009),
    with one move.
    """

    predictor: Predictor
    scale: tuple[float, ...]
    steps: int = 8
    effort: float = 1e-4
    hold: int = 1
    authority: float = 1.0

    def plan(self, state: Array, reference: Array, rng: np.random.Generator) -> Array:
        low, high = self.predictor.plant.limits_at(self.authority)
        reach, eye = high - low, np.eye(len(low))
        wanted = reference[np.minimum(np.arange(self.steps), len(reference) - 1)] / self.scale
        penalty = np.sqrt(self.effort) * eye
        best = np.clip(np.zeros(len(low)), low, high)
        off = self._off(state, best[None, :], wanted)[0]
        for nudge in NUDGES:
            inwards = np.where(best + nudge * reach > high, -nudge, nudge)
            moved = self._off(state, best + inwards[:, None] * reach * eye, wanted)
            columns = np.vstack([((off - moved) / inwards[:, None]).T, penalty])
            if not np.isfinite(columns).all():
                break
            target = np.append(off, penalty @ (-best / reach))
            bounds = (low - best) / reach, (high - best) / reach
            to = lsq_linear(columns, target, bounds, method="bvls").x
            tried = best + np.array(SHORTER)[:, None] * to * reach
            errors = self._off(state, tried, wanted)
            costs = np.nan_to_num((errors**2).sum(axis=1), nan=np.inf) + self.effort * (
                (tried / reach) ** 2
            ).sum(axis=1)
            if costs.min() < off @ off + self.effort * float(((best / reach) ** 2).sum()):
                best, off = tried[np.argmin(costs)], errors[np.argmin(costs)]
        return np.asarray(best)

    def _off(self, state: Array, commands: Array, wanted: Array) -> Array:
        """How far positions are from what is wanted, in the joints' scales, under commands `(rows,
        commands)`, `(rows, steps x joints)`."""
        positions = self._positions(np.repeat(state[None, :], len(commands), axis=0), commands)
        return np.asarray((wanted - positions).reshape(len(commands), -1))

    def _positions(self, states: Array, commands: Array) -> Array:
        """Scaled positions `(rows, steps, joints)` under commands `(rows, commands)` that are
        held."""
        held = self.predictor.hold(states, commands, self.steps * self.hold)
        return np.asarray(held[:, self.hold - 1 :: self.hold, : len(self.scale)] / self.scale)
