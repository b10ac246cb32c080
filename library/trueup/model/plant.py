"""Plant: what plant.json declares of one machine, checked once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, singledispatch

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json, digest_of
from trueup.episode.layout import Channel, Field, Hold, Layout
from trueup.errors import BadPlant
from trueup.model.block import Block, joint, kind
from trueup.model.dynamics import (
    CompiledFamily,
    CompiledTree,
    Dynamics,
    Form,
    strictly_stable,
)
from trueup.model.fields import Reader
from trueup.model.nominal_form import read_nominal
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.tree import Tree

Array = NDArray[np.float64]
INTEGRATOR = "semi_implicit_euler"


@dataclass(frozen=True)
class Plant:
    """One machine: nominal model, channels, envelope, and how its predictions are evaluated.

    `document` is the JSON that it was read from; its digest is the plant's identity. `parameters`
    are the nominal ones in the order of `dynamics.parameter_names`; `joints` the names of the
    joints in the order of a state.
    """

    name: str
    dynamics: Dynamics
    joints: tuple[str | None, ...]
    parameters: tuple[float, ...]
    timestep_s: float
    layout: Layout
    envelope: Mapping[str, tuple[float, float]]
    horizon_s: float
    document: Mapping[str, Json]

    @staticmethod
    def from_document(document: object) -> Plant:
        """Read plant.json. Raises BadPlant with the field that breaks a rule."""
        root = Reader.of(document)
        nominal = root.child("nominal")
        timestep = nominal.number("timestep_s", above=0.0)
        nominal.choice("integrator", [INTEGRATOR], default=INTEGRATOR)
        dynamics, parameters = read_nominal(nominal)
        layout = _layout(root)
        joints = _joints(dynamics, layout)
        envelope = root.child("envelope", optional=True)
        bounds = {name: envelope.interval(name) for name in envelope.value}
        horizon = root.child("evaluation").number("horizon_s", above=timestep)
        root.no_more(
            "name", "nominal", "commands", "observations", "envelope", "evaluation", "topics"
        )
        return Plant(
            root.name("name"),
            dynamics,
            joints,
            parameters,
            timestep,
            layout,
            bounds,
            horizon,
            root.value,
        )

    def require_known_envelope(self) -> None:
        """Raises BadPlant where the envelope names what is no observed channel: it would bound
        nothing, in silence."""
        names = [channel.name for channel in self.layout.observations]
        unknown = [name for name in self.envelope if name not in names]
        if unknown:
            raise BadPlant(
                f"the envelope names {unknown[0]!r}, which is no observation",
                field=f"envelope.{unknown[0]}",
                hint=f"Observations are {', '.join(names)}.",
            )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical document."""
        return digest_of(self.document)

    @property
    def family(self) -> str:
        """What the nominal model is made of: a family's name, or mjcf."""
        return self.dynamics.name

    @property
    def tree(self) -> Tree:
        """A robot's tree of links. Raises TypeError of a plant of a family."""
        if isinstance(self.dynamics, CompiledTree):
            return self.dynamics.tree
        raise TypeError(f"{self.name} is one joint of a family, and has no tree")

    @cached_property
    def nominal(self) -> Mapping[str, float]:
        """The nominal parameters by name."""
        return dict(zip(self.dynamics.parameter_names, self.parameters, strict=True))

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limit of each command, `(commands,)` each."""
        bounds = np.array([c.limits for c in self.layout.commands], float)
        return bounds[:, 0], bounds[:, 1]

    def limits_at(self, authority: float) -> tuple[Array, Array]:
        """Limits of each command, `(commands,)` each, that leave a share of its range, about the
        range's middle."""
        low, high = self.limits
        if authority == 1.0:
            return low, high
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        return middle - authority * half, middle + authority * half

    @cached_property
    def scales(self) -> Array:
        """Declared reporting scale of each observation, `(observations,)`."""
        return np.array([c.scale for c in self.layout.observations])

    @cached_property
    def state_scales(self) -> Array:
        """The scale of each state, `(states,)`: that of its channel, and for a velocity that nobody
        observes its position's in a horizon."""
        joints = len(self.joints)
        scales = np.full(2 * joints, np.nan)
        scales[self.state_columns] = self.scales
        hidden = np.isnan(scales[joints:])
        scales[joints:][hidden] = scales[:joints][hidden] / self.horizon_s
        return scales

    @cached_property
    def form(self) -> Form:
        """What the compiled rollout reads of the nominal model."""
        return self.dynamics.form

    @cached_property
    def block(self) -> Block:
        """How the parameters of the nominal model and of effects lie."""
        return self.dynamics.form.block

    @cached_property
    def state_columns(self) -> NDArray[np.int64]:
        """For each observation the column of the state that it shows, `(observations,)`."""
        n = len(self.joints)
        return np.array(
            [
                self.joint_of(c) + (n if c.field is Field.VELOCITY else 0)
                for c in self.layout.observations
            ]
        )

    @cached_property
    def command_columns(self) -> NDArray[np.int64]:
        """For each joint its command, -1 where it has none, `(joints,)`."""
        of = {self.joint_of(c): i for i, c in enumerate(self.layout.commands)}
        return np.array([of.get(j, -1) for j in range(len(self.joints))])

    @cached_property
    def command_scales(self) -> Array:
        """The largest command that each joint is declared to take, `(joints,)`; 1 where it has
        none."""
        largest = np.append(np.max(np.abs(self.limits), axis=0), 1.0)
        return np.asarray(largest[self.command_columns])

    def joint_of(self, channel: Channel) -> int:
        """Where a channel's joint stands in a state."""
        return self.joints.index(channel.joint) if channel.joint in self.joints else 0

    @property
    def names_joints(self) -> bool:
        """Whether reports name the joint of an effect: where there are several."""
        return len(self.joints) > 1

    def term_words(self, term: str) -> str:
        """A term in words: its effect, with its joint where reports name joints."""
        name = kind(term).name
        return f"{name} at {self.joint_name(joint(term))}" if self.names_joints else name

    def number_name(self, term: str, number: str) -> str:
        """What an effect's number is called in a family of plants: `EFFECT.NUMBER`, where there are
        several joints `EFFECT@JOINT.NUMBER`."""
        at = f"@{self.joint_name(joint(term))}" if self.names_joints else ""
        return f"{kind(term).name}{at}.{number}"

    def joint_name(self, joint: int) -> str:
        """What a joint is called in a report."""
        return self.joints[joint] or "joint"

    def applied(self, issued: Array) -> Array:
        """What the joints get of issued commands `(…, commands)` after the declared limits, `(…,
        joints)`."""
        return self.at_joints(np.clip(issued, *self.limits))

    def at_joints(self, commands: Array) -> Array:
        """Commands `(…, commands)` by joint `(…, joints)`, 0 where it has none."""
        if len(self.joints) == 1:
            return commands
        return np.where(self.command_columns >= 0, commands[..., self.command_columns], 0.0)

    @cached_property
    def undeclared_holds(self) -> bool:
        """Whether nobody declared what some command does between its samples."""
        return any(c.hold is None for c in self.layout.commands)

    def ramps(self, *, ramped: bool) -> NDArray[np.bool_]:
        """Which commands are ramps between their samples, `(commands,)`: those that are declared
        so, and with `ramped` those of which nobody declared anything."""
        return np.array(
            [
                c.hold is Hold.FIRST_ORDER or (ramped and c.hold is None)
                for c in self.layout.commands
            ],
            np.bool_,
        )

    def over_intervals(self, commands: Array, *, ramped: bool = False) -> tuple[Array, Array]:
        """The mean of commands `(samples, commands)` from each sample to the next, and by how much
        they rise meanwhile: nothing, where a command keeps its value."""
        rise = np.diff(commands, axis=0, append=commands[-1:])
        rise[:, ~self.ramps(ramped=ramped)] = 0.0
        return commands + rise / 2.0, rise

    def update(
        self,
        states: Array,
        issued: Array,
        parameters: Sequence[float] | Array | None = None,
        h_s: Array | float | None = None,
    ) -> Array:
        """One semi-implicit Euler step of the plant with these parameters (the nominal ones if
        None)."""
        chosen = np.asarray(self.parameters if parameters is None else parameters, float)
        return self.dynamics.step(
            states, self.applied(issued), chosen, self.timestep_s if h_s is None else h_s
        )

    def observe(self, states: Array) -> Array:
        """Observations `(…, observations)` of states `(…, 2 x joints)`."""
        return states[..., self.state_columns]

    def is_stable(self, parameters: Sequence[float] | None = None) -> bool:
        """Whether the unforced update is strictly stable with these parameters (the nominal ones if
        None)."""
        return strictly_stable(
            self.dynamics,
            np.asarray(self.parameters if parameters is None else parameters, float),
            self.timestep_s,
        )


def _joints(dynamics: Dynamics, layout: Layout) -> tuple[str | None, ...]:
    """The joints in the order of a state. Raises BadPlant where channels and joints do not fit."""
    if any(c.field is Field.EFFORT for c in layout.observations):
        raise BadPlant(
            "an effort is no part of a state; observe positions and velocities",
            field="observations",
        )
    return _joints_of(dynamics, layout)


@singledispatch
def _joints_of(dynamics: Dynamics, layout: Layout) -> tuple[str | None, ...]:
    raise TypeError(type(dynamics).__name__)


@_joints_of.register
def _joints_of_simulator(dynamics: SimulatedDynamics, layout: Layout) -> tuple[str | None, ...]:
    if dynamics.joints == 1:
        return _joint_of_family(dynamics, layout)
    parameters = list(dynamics.simulator.parameters.values())
    return _joints_of_robot(dynamics, parameters, dynamics.simulator.names, layout)


@_joints_of.register(CompiledFamily)
def _joint_of_family(_: Dynamics, layout: Layout) -> tuple[str | None, ...]:
    one_joint = len({c.joint for c in layout.observations}) == 1
    if not one_joint or len(layout.commands) != 1:
        raise BadPlant(
            "a family, or a simulator without `joints`, describes one joint with one command",
            field="observations",
            hint="Describe a robot by its MJCF, or name the joints of its simulator.",
        )
    if not any(c.field is Field.POSITION for c in layout.observations):
        raise BadPlant("a plant needs an observed position", field="observations")
    return (layout.observations[0].joint,)


@_joints_of.register
def _joints_of_tree(dynamics: CompiledTree, layout: Layout) -> tuple[str | None, ...]:
    return _joints_of_robot(dynamics, dynamics.tree.parameters, dynamics.tree.joints, layout)


def _joints_of_robot(
    dynamics: Dynamics, parameters: Sequence[float], joints: tuple[str | None, ...], layout: Layout
) -> tuple[str | None, ...]:
    shown = {c.joint for c in layout.observations if c.field is Field.POSITION}
    for field, channels in (("observations", layout.observations), ("commands", layout.commands)):
        seen: set[tuple[str | None, Field | None]] = set()
        for c in channels:
            if c.joint not in joints:
                raise BadPlant(
                    (
                        f"channel {c.name} names no joint of the model, which are "
                        f"{', '.join(map(str, joints))}"
                    ),
                    field=field,
                )
            what = (c.joint, c.field if field == "observations" else None)
            if what in seen:
                raise BadPlant(
                    f"channel {c.name} is the second one of its kind for joint {c.joint}",
                    field=field,
                )
            seen.add(what)
    for c in layout.commands:
        if not np.ptp(
            dynamics.drive(parameters, joints.index(c.joint), np.zeros(2), np.array([0.0, 1.0]))
        ):
            raise BadPlant(
                f"the model has no actuator at joint {c.joint}, which {c.name} commands",
                field="commands",
            )
    hidden = [str(j) for j in joints if j not in shown]
    if hidden:
        raise BadPlant(
            f"nobody observes the position of {', '.join(hidden)}",
            field="observations",
            hint="Log every joint, or weld it in the model.",
        )
    return joints


def _layout(root: Reader) -> Layout:
    commands = tuple(_channel(r, Field.EFFORT, command=True) for r in root.children("commands"))
    observations = tuple(
        _channel(r, (Field.POSITION, Field.VELOCITY)[min(i, 1)], command=False)
        for i, r in enumerate(root.children("observations"))
    )
    names = [c.name for c in commands + observations]
    if len(set(names)) < len(names):
        raise BadPlant("two channels have one name", field="observations")
    topics = root.child("topics", optional=True)
    topics.no_more("observation", "command", "applied")
    default = Layout(observations, commands)
    return Layout(
        observations,
        commands,
        topics.text("observation", default.observation_topic),
        topics.text("command", default.command_topic),
        topics.text("applied", default.applied_topic),
    )


def _channel(reader: Reader, field: Field, *, command: bool) -> Channel:
    own = ("limits", "hold") if command else ("scale",)
    reader.no_more("name", "unit", "joint", "field", *own)
    chosen = Field(reader.choice("field", list(Field), default=field))
    joint = reader.text("joint", "") or None
    limits = reader.interval("limits") if command else None
    scale = 1.0 if command else reader.number("scale", above=0.0, default=1.0)
    declared = command and "hold" in reader.value
    hold = Hold(reader.choice("hold", list(Hold))) if declared else None
    return Channel(reader.text("name"), reader.text("unit", ""), chosen, joint, scale, limits, hold)
