"""Nominal models as one writes them down: a family with its numbers, or a robot's file.

A model is completed by what was recorded: its step is the time between samples, the limits of its
commands are as far as they went, unless they are given.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.layout import Layout
from trueup.errors import BadPlant, BadSimulator
from trueup.fit.first_model import describe, undriven
from trueup.model.mjcf import compile_file
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.model.simulator.simulator import load_simulator, offer, takes_step


@dataclass(frozen=True)
class NominalModel(ABC):
    """What a user believes of a machine. `name` is the plant's; `timestep_s` [s] the step of its
    integrator; `horizon_s` [s] the length of rollouts that predictions are judged by; `limits` of
    each command by its name, and `envelope` of each observation, `(low, high)`."""

    name: str = field(default="plant", kw_only=True)
    timestep_s: float | None = field(default=None, kw_only=True)
    horizon_s: float | None = field(default=None, kw_only=True)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict, kw_only=True)
    envelope: Mapping[str, tuple[float, float]] = field(default_factory=dict, kw_only=True)

    @property
    def joints(self) -> tuple[str, ...] | None:
        """The joints to look for, None where there is one that needs no name."""
        return None

    @abstractmethod
    def nominal(self) -> dict[str, Any]:
        """The field `nominal` of plant.json, without its step."""

    def plant(self, layout: Layout, episodes: Sequence[Episode]) -> Plant:
        """The plant, completed by episodes of this layout. Raises BadPlant, NotIdentifiable."""
        document = undriven(self.name, layout, episodes)
        step = self.timestep_s or document["nominal"]["timestep_s"]
        document["nominal"] = {**self.nominal(), "timestep_s": step}
        if self.horizon_s is not None:
            document["evaluation"] = {"horizon_s": self.horizon_s}
        return self._read(_bounded(document, self.limits, self.envelope))

    def _read(self, document: dict[str, Json]) -> Plant:
        return Plant.from_document(document)


def _bounded(
    document: dict[str, Any],
    limits: Mapping[str, tuple[float, float]],
    envelope: Mapping[str, tuple[float, float]],
) -> dict[str, Any]:
    names = [c["name"] for c in document["commands"]]
    unknown = next((n for n in limits if n not in names), None)
    if unknown is not None:
        raise BadPlant(f"there is no command {unknown!r}", field="limits", hint=", ".join(names))
    for command in document["commands"]:
        if command["name"] in limits:
            command["limits"] = list(limits[command["name"]])
    if envelope:
        document["envelope"] = {name: list(bounds) for name, bounds in envelope.items()}
    return document


@dataclass(frozen=True)
class Pendulum(NominalModel):
    """A joint under gravity: a = -k sin q - c v + b u, per unit of inertia, in SI."""

    k: float
    c: float
    b: float

    def nominal(self) -> dict[str, Any]:
        return {"family": "pendulum", "parameters": {"k": self.k, "c": self.c, "b": self.b}}


@dataclass(frozen=True)
class Oscillator(NominalModel):
    """A joint on a spring, or a position servo: a = -k q - c v + b u, per unit of inertia."""

    k: float
    c: float
    b: float

    def nominal(self) -> dict[str, Any]:
        return {"family": "oscillator", "parameters": {"k": self.k, "c": self.c, "b": self.b}}


@dataclass(frozen=True)
class Inertia(NominalModel):
    """A joint that turns or slides freely: a = -c v + b u, per unit of inertia."""

    c: float
    b: float

    def nominal(self) -> dict[str, Any]:
        return {"family": "inertia", "parameters": {"c": self.c, "b": self.b}}


@dataclass(frozen=True)
class Robot(NominalModel):
    """A robot of any joints, given as MJCF or URDF. Needs `trueup[mujoco]`."""

    file: str | PathLike[str]

    @property
    def path(self) -> Path:
        """The file."""
        return Path(self.file)

    @property
    def joints(self) -> tuple[str, ...]:
        return compile_file(self.path).tree.joints

    def nominal(self) -> dict[str, Any]:
        return {"mjcf": self.path.name}

    def _read(self, document: dict[str, Json]) -> Plant:
        return Plant.from_document(resolved(document, self.path.resolve().parent))


@dataclass(frozen=True)
class Simulator(NominalModel):
    """A simulator of your own: a function, or a file that holds one.

    `step(state, command, parameters) -> state` moves many simulations at once: `state` `(lanes, 2 x
    joints)` with the positions of all joints, then their velocities; `command` `(lanes, joints)`;
    `parameters` a dict of arrays `(lanes,)`. It may also take `force` `(lanes, joints)`, which lets
    effects push and hold, and `h_s` `(lanes,)` [s], the length of the step. A file is Python that
    defines `step`, or an ONNX model.

    `parameters` are those that may be off, with their nominal values; `begins` the values with
    which further columns of the state begin, that nobody observes; `joints` the names of several
    joints, in the order of the state's columns. `timestep_s` [s] is the step that the simulator
    makes, unless it takes `h_s`. Raises BadSimulator.
    """

    step: Callable[..., Any] | str | PathLike[str]
    parameters: Mapping[str, float]
    begins: tuple[float, ...] = ()
    joints: tuple[str, ...] | None = None

    def nominal(self) -> dict[str, Any]:
        if callable(self.step):
            name, sha256 = (
                getattr(self.step, "__name__", type(self.step).__name__),
                offer(self.step),
            )
        else:
            name, sha256 = Path(self.step).name, load_simulator(self.step)
        if self.timestep_s is None and not takes_step(sha256):
            raise BadSimulator(
                f"{name} makes steps of one length, and nobody said which",
                hint="Give timestep_s, or let the function take h_s.",
                field="timestep_s",
            )
        return {
            "simulator": name,
            "sha256": sha256,
            "parameters": dict(self.parameters),
            **({"begins": list(self.begins)} if self.begins else {}),
            **({"joints": list(self.joints)} if self.joints else {}),
        }


@dataclass(frozen=True)
class FirstModel(NominalModel):
    """The simplest family that the recordings allow, with the numbers that fit them: for a machine
    of which nobody has a model."""

    family: str | None = None

    def nominal(self) -> dict[str, Any]:
        return {}

    def plant(self, layout: Layout, episodes: Sequence[Episode]) -> Plant:
        document: dict[str, Any] = describe(self.name, layout, episodes, self.family)
        return Plant.from_document(_bounded(document, self.limits, self.envelope))
