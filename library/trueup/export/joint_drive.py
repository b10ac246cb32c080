"""Joint drives: of each joint of a corrected model what an actuator's configuration asks for, with
95 % intervals, and what no configuration can hold.

A family is one joint per unit of inertia: its numbers become forces by the inertia that a user
gives, 1 where nobody does, and so do those of a simulator that takes no force. A simulator's are
those of its motion near rest, a robot's are forces already. The interval of a number that several
unknown ones make is that of independent errors, to first order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.collect.ensemble import Ensemble
from trueup.episode.layout import Field
from trueup.errors import NotExportable
from trueup.export.provenance import Provenance
from trueup.model.block import joint, kind
from trueup.model.corrected import Corrected
from trueup.model.dynamics import CompiledFamily, CompiledTree, Dynamics
from trueup.model.effect import effects, equation_in
from trueup.model.mjcf_patch import Left
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.tree import (
    ARMATURE,
    DAMPING,
    FRICTION,
    GAIN,
    JOINT,
    LIMIT,
    LINK,
    NO_LIMIT,
    OFFSET,
    SERVO,
    STIFFNESS,
)

Array = NDArray[np.float64]
TIED = 0.8  # a correlation that a file of independent ranges must name
TWO_SIDED = 1.96  # standard deviations of a 95 % interval
NEAR_REST = 1e-3  # of a unit of position, velocity and command: a simulator's slopes
NUDGE = 0.5  # standard deviations to either side, for derivatives
# What a drive holds, in newton metres or newtons, seconds, and the joint's own unit.
NUMBERS = (
    "gain",  # force for a unit of the command
    "servo",  # position gain of the servo, 0 of a motor
    "damping",  # viscous, of the joint and the servo together
    "armature",
    "spring",  # passive
    "friction",  # dry, in motion
    "breakaway",  # dry, at rest
    "limit",  # of the drive's force, inf where none is known
    "delay",
    "lag",
    "offset",  # constant force of the drive
)
# of which numbers an effect is a part, for drives that hold all of it
HELD = ("coulomb_friction", "stribeck_friction", "saturation", "actuator_delay", "constant_force")


@dataclass(frozen=True, slots=True)
class Ranged:
    """A number with its 95 % interval, which has no width where none is known."""

    value: float
    low: float
    high: float

    @staticmethod
    def exactly(value: float) -> Ranged:
        """A number whose interval is not known."""
        return Ranged(value, value, value)

    @property
    def is_certain(self) -> bool:
        """Whether it has no width."""
        return self.low == self.high


@dataclass(frozen=True, slots=True)
class JointDrive:
    """The drive of one joint: NUMBERS by name, and whether it is commanded by positions."""

    joint: str
    commands_position: bool
    numbers: Mapping[str, Ranged]

    def __getitem__(self, name: str) -> Ranged:
        return self.numbers[name]


@dataclass(frozen=True)
class Drives:
    """The drives of a corrected model, with where they come from: the plant, the artifact's digest,
    the diagnosis's sentence, the explanations that it could not tell from its answer, what no drive
    holds, the inertia that forces were multiplied by, the largest torque of gravity on a pendulum,
    0 of what is none, the pairs of numbers that are off together, and of a simulator what the asset
    must hold `beside` the drives."""

    plant: Plant
    digest: str
    answer: str | None
    alternatives: tuple[str, ...]
    drives: tuple[JointDrive, ...]
    left: tuple[Left, ...]
    inertia: float | None
    gravity: float = 0.0
    tied: tuple[str, ...] = ()
    beside: str = ""

    @property
    def is_per_inertia(self) -> bool:
        """Whether forces are per unit of inertia, where no inertia was given."""
        return self.plant.form.per_inertia


def drives_of(
    predictor: Predictor,
    digest: str,
    report: Mapping[str, Any] | None = None,
    inertia: float | None = None,
) -> Drives:
    """The drives of a predictor; with the report of its diagnosis, their intervals. `inertia`
    [kg m^2, or kg] is that of the one joint of a family. Raises NotExportable."""
    model = Corrected.form_of(predictor)
    if model is None:
        raise NotExportable(
            f"a predictor of the kind {predictor.kind!r} is no machine with drives",
            hint="Export a version that a diagnosis or an identification made.",
        )
    if inertia is not None and not inertia > 0.0:
        raise NotExportable(
            f"an inertia is above 0, this is {inertia:g}", hint="Give kg m^2, or kg."
        )
    plant = model.plant
    reader = _reader(plant.dynamics, plant, inertia)
    centre = np.array(model.values, float)
    numbers = _numbers(reader, model, centre)
    variance = {key: np.zeros(len(NUMBERS)) for key in numbers}
    if report is not None:
        known = Ensemble.posterior(model, report)
        for row, spread in zip(known.rows, known.spread, strict=True):
            ahead, behind = centre.copy(), centre.copy()
            ahead[row] += NUDGE * spread
            behind[row] -= NUDGE * spread
            up, down = (_numbers(reader, model, v) for v in (ahead, behind))
            for key in numbers:
                known_both = np.isfinite(up[key]) & np.isfinite(down[key])
                step = np.where(known_both, up[key], 0.0) - np.where(known_both, down[key], 0.0)
                variance[key] += (step / (2.0 * NUDGE)) ** 2
    provenance = None if report is None else Provenance.of(report)
    return Drives(
        plant,
        digest,
        provenance.answer if provenance else None,
        provenance.alternatives if provenance else (),
        tuple(_drive(plant, j, numbers[j], np.sqrt(variance[j])) for j in numbers),
        tuple(_left(model)),
        inertia,
        (inertia or 1.0) * float(centre[0]) if plant.family == "pendulum" else 0.0,
        _tied(report),
        _beside(plant.dynamics, model),
    )


@singledispatch
def _beside(_: Dynamics, model: Corrected) -> str:
    """What the target's own asset must hold, in words."""
    return ""


@_beside.register
def _beside_a_simulator(dynamics: SimulatedDynamics, model: Corrected) -> str:
    numbers = model.values[: len(dynamics.parameter_names)]
    named = zip(dynamics.parameter_names, numbers, strict=True)
    sizes = ", ".join(f"{x:.6g}" for x in dynamics.sizes(numbers))
    inertia = f"of {sizes} " if dynamics.takes_force else ""
    of = "joint's inertia" if dynamics.joints == 1 else "joints' inertias at rest"
    return (
        f"The asset must hold the {of} {inertia}and what gravity and springs do, as the "
        f"simulator has them with {', '.join(f'{n} {x:.6g}' for n, x in named)}."
    )


def _tied(report: Mapping[str, Any] | None) -> tuple[str, ...]:
    """The pairs of numbers whose errors go together, in words."""
    pairs = [] if report is None else report["evidence"].get("correlations", [])
    strong = sorted((p for p in pairs if abs(p[2]) >= TIED), key=lambda p: -abs(p[2]))
    return tuple(f"{first} with {second} ({value:+.2f})" for first, second, value in strong)


def _drive(plant: Plant, j: int, numbers: Array, spread: Array) -> JointDrive:
    command = plant.layout.commands[int(plant.command_columns[j])]
    ranged = {}
    for name, value, deviation in zip(NUMBERS, numbers, spread, strict=True):
        low, high = value - TWO_SIDED * deviation, value + TWO_SIDED * deviation
        if value >= 0.0:  # no size changes its sign
            low = max(low, 0.0)
        ranged[name] = Ranged(float(value), float(low), float(high))
    return JointDrive(plant.joint_name(j), command.field is Field.POSITION, ranged)


class _Reader(ABC):
    """Reads a joint's numbers off the values of a model."""

    @abstractmethod
    def numbers(self, values: Array, j: int) -> dict[str, float]:
        """What a joint's form has of NUMBERS."""

    @abstractmethod
    def size(self, j: int) -> float:
        """The inertia that the forces of effects are multiplied by."""


@singledispatch
def _reader(dynamics: Dynamics, plant: Plant, inertia: float | None) -> _Reader:
    raise TypeError(type(dynamics).__name__)


@_reader.register
def _of_family(_: CompiledFamily, plant: Plant, inertia: float | None) -> _Reader:
    return _Family(plant, 1.0 if inertia is None else inertia)


@_reader.register
def _of_tree(dynamics: CompiledTree, plant: Plant, inertia: float | None) -> _Reader:
    if inertia is not None:
        raise NotExportable(
            "a robot's inertias are those of its model",
            hint="Leave --inertia out: it is for one joint of a family.",
        )
    return _Robot(dynamics)


@_reader.register
def _of_simulator(dynamics: SimulatedDynamics, plant: Plant, inertia: float | None) -> _Reader:
    if inertia is not None and (dynamics.takes_force or dynamics.joints > 1):
        raise NotExportable(
            "the simulator takes forces, which say what its inertia is"
            if dynamics.takes_force
            else "the simulator has several joints, each with an inertia of its own",
            hint="Leave --inertia out: it is for one joint of a family.",
        )
    return _Simulator(dynamics, plant, 1.0 if inertia is None else inertia)


class _Simulator(_Reader):
    """A simulator's joint as it moves near rest: what its command does, and how velocity and, of a
    servo, position hold it back. What else it does is the target's own model's."""

    def __init__(self, dynamics: SimulatedDynamics, plant: Plant, inertia: float) -> None:
        self._dynamics, self._count, self._inertia = dynamics, len(plant.parameters), inertia
        self._commands = [plant.layout.commands[k] for k in plant.command_columns]

    def numbers(self, values: Array, j: int) -> dict[str, float]:
        own, joints = values[: self._count], self._dynamics.joints
        mass = np.eye(joints)
        if self._dynamics.takes_force:
            mass = self._dynamics.mass(own, np.zeros((1, joints)))[0]
        slopes = []
        for column in (j, joints + j, 2 * joints + j):  # of position, velocity and command
            motion = np.zeros((2, 3 * joints))
            motion[:, column] = NEAR_REST, -NEAR_REST
            a = self._dynamics.acceleration(own, motion[:, : 2 * joints], motion[:, 2 * joints :])
            slopes.append(self._inertia * float(mass[j] @ (a[0] - a[1])) / (2.0 * NEAR_REST))
        by_q, by_v, by_u = slopes
        is_servo = self._commands[j].field is Field.POSITION
        # what holds the joint beyond its servo is the asset's own spring or gravity
        return {"gain": by_u, "damping": -by_v, "servo": min(by_u, -by_q) if is_servo else 0.0}

    def size(self, j: int) -> float:
        # what effects are measured by stays that of the nominal numbers
        return float(self._dynamics.form.sizes[j]) * self._inertia


class _Family(_Reader):
    def __init__(self, plant: Plant, inertia: float) -> None:
        self._names, self._inertia = plant.dynamics.parameter_names, inertia
        self._is_servo = plant.layout.commands[0].field is Field.POSITION
        self._family = plant.family

    def numbers(self, values: Array, j: int) -> dict[str, float]:
        given = dict(zip(self._names, values, strict=False))
        gain, damping = self._inertia * given["b"], self._inertia * given["c"]
        spring = self._inertia * given.get("k", 0.0) if self._family == "oscillator" else 0.0
        servo = min(gain, spring) if self._is_servo else 0.0  # the spring that the drive itself is
        return {"gain": gain, "damping": damping, "servo": servo, "spring": spring - servo}

    def size(self, j: int) -> float:
        return self._inertia


class _Robot(_Reader):
    def __init__(self, dynamics: CompiledTree) -> None:
        self._tree, self._sizes = dynamics.tree, dynamics.form.sizes

    def numbers(self, values: Array, j: int) -> dict[str, float]:
        first = LINK * len(self._tree.joints) + JOINT * j
        row, constants = values[first : first + JOINT], self._tree.constants[j]
        limit = float(constants[LIMIT])
        return {
            "gain": float(row[GAIN]),
            "servo": float(row[SERVO]),
            "damping": float(row[DAMPING]),
            "armature": float(row[ARMATURE]),
            "spring": float(row[STIFFNESS]),
            "friction": float(row[FRICTION]),
            "breakaway": float(row[FRICTION]),
            "offset": float(constants[OFFSET]),
            **({"limit": limit} if limit < NO_LIMIT else {}),
        }

    def size(self, j: int) -> float:
        return float(self._sizes[j])


def _numbers(reader: _Reader, model: Corrected, values: Array) -> dict[int, Array]:
    """NUMBERS of each commanded joint."""
    plant = model.plant
    commanded = [j for j in range(len(plant.joints)) if plant.command_columns[j] >= 0]
    own = {j: {"limit": np.inf, **reader.numbers(values, j)} for j in commanded}
    for term in model.hypothesis.effects:
        j = joint(term)
        if j in own:
            rows = plant.block.rows_of(term)
            _add(
                kind(term).name,
                {name: float(values[row]) for name, row in rows.items()},
                reader.size(j),
                own[j],
            )
    return {j: np.array([of.get(name, 0.0) for name in NUMBERS]) for j, of in own.items()}


def _add(effect: str, values: Mapping[str, float], size: float, into: dict[str, float]) -> None:
    """Add an effect's numbers to a joint's."""
    if effect in ("coulomb_friction", "stribeck_friction"):
        level, extra = size * values["level"], size * values.get("extra", 0.0)
        into["friction"] = into.get("friction", 0.0) + level
        into["breakaway"] = into.get("breakaway", 0.0) + level + extra
    elif effect == "saturation":
        into["limit"] = abs(into["servo"] or into["gain"]) * values["limit"]
    elif effect == "actuator_delay":
        into["delay"] = values["delay"]
    elif effect == "actuator_lag":
        into["lag"] = values["time_constant"]
    elif effect == "constant_force":
        into["offset"] = into.get("offset", 0.0) + size * values["level"]


INSTEAD = {
    "actuator_lag": "filter the command: u' += (u - u') dt / (tau + dt), tau the time constant",
    "stribeck_friction": "friction and breakaway are held; how fast one becomes the other is not",
}


def _left(model: Corrected) -> list[Left]:
    """What no actuator's configuration holds, and what to write instead."""
    left = []
    for term in model.hypothesis.effects:
        name = kind(term).name
        if name not in HELD or name in INSTEAD:
            equation = equation_in(effects()[name].__doc__)
            instead = INSTEAD.get(name, f"write it into the step of the simulation: {equation}")
            left.append(Left(name, model.plant.joint_name(joint(term)), instead))
    return left
