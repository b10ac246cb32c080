"""Detector: follows residuals from episode to episode, and alarms where its statistic passes its
level.

A detector is calibrated on healthy blocks, parts of episodes of one length in rollouts, to a
promised rate of false alarms. What the promise rests on differs, and each kind says it. No residual
and no run of residuals reaches over the end of an episode; what a sum has gathered does, for a
quiet drift shows over episodes only.
"""

from __future__ import annotations

import importlib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.monitor.residuals import Residuals

Array = NDArray[np.float64]
State = tuple[float, ...]
CAUTION = 0.5  # levels from a hundred blocks miss their rate by a factor of two, either way


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Healthy residuals that a detector is calibrated on.

    `fitted` are blocks of the episodes whose spread is the measure, `fresh` blocks of others, all
    of `windows` rollouts; a block stands for `block_s` [s] of robot time. `promise_h` [h] is the
    operating time in which one false alarm is allowed.
    """

    fitted: Sequence[Residuals]
    fresh: Sequence[Residuals]
    windows: int
    block_s: float
    promise_h: float

    @property
    def rate(self) -> float:
        """Alarms that are allowed for each block."""
        return self.block_s / (3600.0 * self.promise_h)

    @property
    def cautious_rate(self) -> float:
        """The rate to aim at where the level is an estimate."""
        return CAUTION * self.rate


@dataclass(frozen=True, slots=True, eq=False)
class FollowedEpisode:
    """The result of following one episode: the statistic at each sample `(samples,)`, and the state
    after it.

    `alarm` is the sample at which an alarm is declared, or None, and `leading` the index of the
    statistic that declared it.
    """

    statistic: Array
    alarm: int | None
    leading: int | None
    state: State


class Detector(ABC):
    """Base of a frozen dataclass that follows residuals. Its state is passed in and returned:
    `begin`, then `follow` for each episode in order. An episode has one alarm at most."""

    name: ClassVar[str]
    rests_on: ClassVar[str]  # what its false-alarm figure needs to hold
    guarantee: ClassVar[bool] = False  # whether that figure is proven, given what it rests on
    follows: ClassVar[str] = (
        # what it adds up: residuals of channels, or what they have in common with signatures
        "channels"
    )
    reads_fresh: ClassVar[bool] = False  # whether it knows the fresh half of its reference
    level: float

    @staticmethod
    @abstractmethod
    def calibrate(reference: Reference, rng: np.random.Generator) -> Detector:
        """The detector whose false alarms are as rare as promised."""

    @abstractmethod
    def begin(self) -> State:
        """The state before the first episode."""

    @abstractmethod
    def follow(self, state: State, residuals: Residuals) -> FollowedEpisode:
        """Follow one more episode from a state."""

    @abstractmethod
    def exceedance(self, residuals: Residuals) -> float:
        """The share of an episode's units, samples or blocks, that exceed the level by themselves.
        One that does is not an alarm yet."""

    @abstractmethod
    def labels(self, channels: Sequence[str], signs: Sequence[str]) -> list[str]:
        """What each of the detector's statistics stands for, in words."""

    @abstractmethod
    def document(self) -> dict[str, Json]:
        """The detector's numbers as JSON."""

    @staticmethod
    @abstractmethod
    def restore(document: Mapping[str, Any]) -> Detector:
        """The detector from what `document` returned. Raises KeyError, TypeError, ValueError."""


@cache
def detectors() -> dict[str, type[Detector]]:
    """Every kind of detector, by name."""
    from trueup.monitor import detectors as package  # noqa: PLC0415  (the files import this module)

    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    concrete: list[type[Detector]] = []
    waiting = list(Detector.__subclasses__())
    while waiting:
        kind = waiting.pop()
        waiting += kind.__subclasses__()
        concrete += [] if getattr(kind, "__abstractmethods__", None) else [kind]
    return {d.name: d for d in sorted(concrete, key=lambda d: d.name)}
