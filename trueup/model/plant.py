"""Plant: what plant.json declares of one machine, checked once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json, digest_of
from trueup.episode.layout import Channel, Field, Layout
from trueup.errors import BadPlant
from trueup.model.dynamics import CompiledFamily, Dynamics, strictly_stable
from trueup.model.family import families
from trueup.model.fields import Reader

Array = NDArray[np.float64]
INTEGRATOR = "semi_implicit_euler"


@dataclass(frozen=True)
class Plant:
    """One machine: nominal model, channels, envelope, and how its predictions are evaluated.

    `document` is the JSON that it was read from; its digest is the plant's identity. `parameters` are the nominal ones in
    the order of `dynamics.parameter_names`.
    """

    name: str
    dynamics: Dynamics
    family: str
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
        family, parameters, timestep = _nominal(nominal)
        dynamics = CompiledFamily(families()[family])
        layout = _layout(root)
        envelope = root.child("envelope", optional=True)
        bounds = {name: envelope.interval(name) for name in envelope.value}
        horizon = root.child("evaluation").number("horizon_s", above=timestep)
        root.no_more("name", "nominal", "commands", "observations", "envelope", "evaluation", "topics")
        return Plant(root.name("name"), dynamics, family, parameters, timestep, layout, bounds, horizon, root.value)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical document."""
        return digest_of(self.document)

    @cached_property
    def nominal(self) -> Mapping[str, float]:
        """The nominal parameters by name."""
        return dict(zip(self.dynamics.parameter_names, self.parameters, strict=True))

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limit of each command, `(commands,)` each."""
        bounds = np.array([c.limits for c in self.layout.commands], float)
        return bounds[:, 0], bounds[:, 1]

    @cached_property
    def scales(self) -> Array:
        """Declared reporting scale of each observation, `(observations,)`."""
        return np.array([c.scale for c in self.layout.observations])

    @cached_property
    def state_columns(self) -> NDArray[np.int64]:
        """For each observation the column of the state that it shows, `(observations,)`."""
        joints = list(dict.fromkeys(c.joint for c in self.layout.observations))
        return np.array([joints.index(c.joint) + (len(joints) if c.field is Field.VELOCITY else 0) for c in self.layout.observations])

    def applied(self, issued: Array) -> Array:
        """What is left of issued commands after the declared limits."""
        return np.clip(issued, *self.limits)

    def update(
        self, states: Array, issued: Array, parameters: Sequence[float] | Array | None = None, h_s: Array | float | None = None
    ) -> Array:
        """One semi-implicit Euler step of the plant with these parameters (the nominal ones if None)."""
        chosen = np.asarray(self.parameters if parameters is None else parameters, float)
        return self.dynamics.step(states, self.applied(issued), chosen, self.timestep_s if h_s is None else h_s)

    def observe(self, states: Array) -> Array:
        """Observations `(…, observations)` of states `(…, 2 x joints)`."""
        return states[..., self.state_columns]

    def is_stable(self, parameters: Sequence[float] | None = None) -> bool:
        """Whether the unforced update is strictly stable with these parameters (the nominal ones if None)."""
        return strictly_stable(self.dynamics, np.asarray(self.parameters if parameters is None else parameters, float), self.timestep_s)


def _nominal(nominal: Reader) -> tuple[str, tuple[float, ...], float]:
    if "mjcf" in nominal.value:
        raise BadPlant(
            "robots given as MJCF are not served by this version",
            field="nominal.mjcf",
            hint="Describe one joint by a family: " + ", ".join(families()),
        )
    family = nominal.choice("family", list(families()))
    timestep = nominal.number("timestep_s", above=0.0)
    nominal.choice("integrator", [INTEGRATOR], default=INTEGRATOR)
    given = nominal.child("parameters")
    names = [p.name for p in families()[family].params]
    given.no_more(*names)
    nominal.no_more("family", "parameters", "timestep_s", "integrator")
    return family, tuple(given.number(name) for name in names), timestep


def _layout(root: Reader) -> Layout:
    commands = tuple(_channel(r, Field.EFFORT, command=True) for r in root.children("commands"))
    observations = tuple(
        _channel(r, (Field.POSITION, Field.VELOCITY)[min(i, 1)], command=False) for i, r in enumerate(root.children("observations"))
    )
    names = [c.name for c in commands + observations]
    if len(set(names)) < len(names):
        raise BadPlant("two channels have one name", field="observations")
    if {c.joint for c in observations} != {observations[0].joint} or len(commands) != 1:
        raise BadPlant(
            "a family describes one joint with one command", field="observations", hint="Register each joint as a plant of its own."
        )
    if Field.POSITION not in {c.field for c in observations}:
        raise BadPlant("a plant needs an observed position", field="observations")
    topics = root.child("topics", optional=True)
    topics.no_more("observation", "command")
    default = Layout(observations, commands)
    return Layout(
        observations, commands, topics.text("observation", default.observation_topic), topics.text("command", default.command_topic)
    )


def _channel(reader: Reader, field: Field, *, command: bool) -> Channel:
    reader.no_more("name", "unit", "joint", "field", "limits" if command else "scale")
    chosen = Field(reader.choice("field", list(Field), default=field))
    joint = reader.text("joint", "") or None
    limits = reader.interval("limits") if command else None
    scale = 1.0 if command else reader.number("scale", above=0.0, default=1.0)
    return Channel(reader.text("name"), reader.text("unit", ""), chosen, joint, scale, limits)
