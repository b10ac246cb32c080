"""Machines: what stands under control in a simulated closed loop.

    Predicted    moves as a predictor says, one step after the other
    Diagnosed    moves as a diagnosis describes it: its effects keep their states from tick to tick,
                 and its sensors show what they would

A machine takes any share of its actuators' authority away: `authority` 0.5 leaves half the range of
each command, about its middle.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.model.block import BLOCK
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import switches
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.model.roll import roll
from trueup.model.series import unobserved

Array = NDArray[np.float64]
# the first that there is stands in for the machine; the nominal model last, for it is in question
PREFERRED = ("corrected", "identified", "residual", "conditioned", "blind", "nominal")


class Machine(ABC):
    """A simulated machine of a `plant`, with a share of its `authority`."""

    model: Predictor
    authority: float

    @property
    def plant(self) -> Plant:
        """The plant as declared."""
        return self.model.plant

    @abstractmethod
    def after(self, states: Array, issued: Array, hold: int) -> Array:
        """What the sensors show `hold` steps after the last of `states` `(ticks, states)`, under
        the last of the commands `(ticks, commands)` issued at them, `(states,)`."""

    def applied(self, issued: Array) -> Array:
        """What the actuators' limits leave of issued commands `(…, commands)`, in their units."""
        return np.asarray(np.clip(issued, *self.plant.limits_at(self.authority)))


@dataclass(frozen=True, slots=True)
class Predicted(Machine):
    """A machine that moves as a predictor says."""

    model: Predictor
    authority: float = 1.0

    def after(self, states: Array, issued: Array, hold: int) -> Array:
        return np.asarray(self.model.hold(states[-1:], self.applied(issued[-1:]), hold)[0, -1])


@dataclass(frozen=True, slots=True)
class Diagnosed(Machine):
    """A machine as a diagnosis describes it. It is rolled out from its start at each tick, so that
    delays, lags, play and heat have the past that they need."""

    model: Corrected
    authority: float = 1.0

    def after(self, states: Array, issued: Array, hold: int) -> Array:
        model, plant, joints = self.model, self.plant, len(self.plant.joints)
        samples = len(issued) * hold + 1
        t_s = np.asarray(np.arange(samples) * plant.timestep_s, np.float64)
        commands = np.repeat(plant.applied(self.applied(issued)), hold, axis=0)
        series = unobserved(
            model.scheme,
            t_s,
            np.concatenate([commands, commands[-1:]]),
            plant.command_scales,
            plant.timestep_s,
        )
        lanes = np.repeat(np.array(model.values)[:, None], BLOCK, axis=1)
        on = switches(model.hypothesis, joints)
        init = np.repeat(states[0][None, :, None], BLOCK, axis=2)
        return np.asarray(roll(series, plant.form, lanes, on, init)[-1, :, 0])


def machine_of(model: Predictor) -> Machine:
    """The machine that a model describes."""
    return Diagnosed(model) if isinstance(model, Corrected) else Predicted(model)


def with_authority(machine: Machine, authority: float) -> Machine:
    """A machine with a share of its actuators' range."""
    return replace(machine, authority=authority)  # type: ignore[type-var]


def stand_in(models: Mapping[str, Predictor]) -> tuple[str, Machine]:
    """The machine to simulate in the place of the real one, and the name of its model: a diagnosis
    if there is one, else identified parameters, and so on as PREFERRED; of equals the first.

    Raises ValueError without models.
    """
    if not models:
        raise ValueError("no model is given that could stand in for the machine")
    name = min(models, key=lambda n: PREFERRED.index(models[n].kind))
    return name, machine_of(models[name])


STANDS_IN: Mapping[str, str] = {
    "corrected": "the machine as it was diagnosed",
    "identified": "the nominal form with identified parameters",
    "residual": "the machine as a residual model predicts it",
    "conditioned": "the machine as a model of its family predicts it",
    "blind": "the machine as a model of its family predicts it",
    "nominal": "the nominal plant as declared",
}


def why_stands_in(kind: str) -> str:
    """Why no better description stands in for the machine; empty for a diagnosis."""
    if kind == "corrected":
        return ""
    missing = "diagnosed or identified" if kind == "nominal" else "diagnosed"
    return f"nobody has {missing} the machine"


def words_of(kind: str) -> str:
    """What stands in for the machine, and why nothing better does."""
    why = why_stands_in(kind)
    return f"{STANDS_IN[kind]}, since {why}" if why else STANDS_IN[kind]
