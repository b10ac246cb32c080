"""Corrected: the nominal form with the numbers and effects that a diagnosis found.

A rollout starts from a filter that ran over the episode's past: the same model, corrected by each
observation with a gain that soon is constant. So lag, play, heat and hysteresis have the past that
they need, and noise of the starting sample is averaged out. Where no velocity is observed, an
episode's first is the one known from like positions and commands. Source of the gain: R. E. Kalman,
Journal of Basic Engineering 82 (1960).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.errors import NotExportable
from trueup.model.block import BLOCK, FILTERS, joint, kind, term
from trueup.model.dynamics import CompiledFamily, CompiledTree, Dynamics
from trueup.model.effect import Port, effects, known_effect, source_of
from trueup.model.hypothesis import Hypothesis, switches
from trueup.model.joint_effects import Acting, JointEffects
from trueup.model.joint_step import JointStep
from trueup.model.plant import Plant
from trueup.model.predictor import Physical, Predictor
from trueup.model.roll import roll, roll_parts
from trueup.model.series import (
    DECLARED,
    Scheme,
    Series,
    positions_and_velocities,
    unobserved,
    whole,
)
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.stack import Part, RolloutOf, Stack
from trueup.model.state import past_states
from trueup.model.stepping import Columns, Stepping
from trueup.model.tree_dynamics import TreeDynamics
from trueup.model.tree_step import TreeStep
from trueup.model.velocity_prior import VelocityPrior
from trueup.model.windows import Windows

Array = NDArray[np.float64]

# what a simulator's corrections go into, where a form of the whole model is asked for
TO_A_TARGET = "Take the corrected drives elsewhere: `trueup convert --target`, or answer.export()."


@dataclass(frozen=True)
class Corrected(Predictor):
    """A nominal form with effects.

    `values` is the block's vector; `gain` `(beginning, joints, 4, 2)` corrects each joint's
    position, velocity, a disturbing acceleration and what hides the velocity by its observed
    position and velocity, at each of an episode's first samples and, the last, at all others;
    `known` is the prior of a first velocity that was not observed.
    """

    plant: Plant
    hypothesis: Hypothesis
    values: tuple[float, ...]
    scheme: Scheme
    gain: tuple[tuple[float, ...], ...] = ()  # a row for each sample, eight numbers of each joint
    known: VelocityPrior | None = None
    kind = "corrected"

    @staticmethod
    def of_numbers(plant: Plant, parameters: Sequence[float]) -> Corrected:
        """The nominal form with its own parameters, and no effect."""
        values = plant.block.nulls.copy()
        values[: len(parameters)] = parameters
        return Corrected(plant, Hypothesis(), tuple(float(x) for x in values), DECLARED)

    def with_parameters(self, parameters: Sequence[float]) -> Corrected:
        """Its effects on other parameters of the nominal form, `(parameters,)`."""
        given = tuple(float(x) for x in parameters)
        return replace(self, values=given + self.values[len(given) :])

    @staticmethod
    def form_of(predictor: Predictor) -> Corrected | None:
        """A predictor as numbers and effects; None of one that is none."""
        if isinstance(predictor, Physical):
            return Corrected.of_numbers(predictor.plant, predictor.parameters)
        return predictor if isinstance(predictor, Corrected) else None

    @cached_property
    def stepping(self) -> Stepping:
        """The model one step at a time, in numpy. Raises NotExportable of a simulator."""
        return _stepping(self.plant.dynamics, self)

    def predict_batch(
        self, states: Array, issued: Array, h_s: Array | float | None = None
    ) -> Array:
        """One step of the symmetric or declared scheme, with hidden states as they begin; of a
        family in numpy, the kernel's reference."""
        span = np.broadcast_to(self.plant.timestep_s if h_s is None else h_s, len(states))
        return _advance(self.plant.dynamics, self, states, self.plant.applied(issued), span)

    def hold(self, states: Array, issued: Array, steps: int) -> Array:
        return _hold(self.plant.dynamics, self, states, issued, steps)

    @property
    def acting(self) -> Hypothesis:
        """The effects that change the state under a held command: neither delays nor sensors."""
        return Hypothesis(
            tuple(
                t
                for t in self.hypothesis.effects
                if not kind(t).delays() and kind(t).port is not Port.OBSERVATION
            )
        )

    def compiled_hold(self, state: Array, applied: Array, t_s: Array) -> Array:
        """States `(samples, states)` at times `t_s` from one `(states,)` on under one applied
        command, compiled, with what effects remember meanwhile; what delays a command has none
        before it to show."""
        commands = np.tile(applied, (len(t_s), 1))
        s = unobserved(self.scheme, t_s, commands, self.plant.command_scales, float(t_s[1]))
        return self._rolled(s, state, self.acting)

    def _rolled(self, s: Series, initial: Array, hypothesis: Hypothesis) -> Array:
        """States `(samples, states)` of a series from one state on, compiled."""
        init = np.repeat(initial[None, :, None], BLOCK, axis=2)
        on = switches(hypothesis, len(self.plant.joints))
        return np.asarray(roll(s, self.plant.form, self.lanes(), on, init)[:, :, 0])

    def run(self, initial: Array, issued: Array) -> Array:
        plant = self.plant
        t_s = np.asarray(np.arange(len(issued)) * plant.timestep_s, np.float64)
        applied = plant.applied(issued)
        s = unobserved(self.scheme, t_s, applied, plant.command_scales, plant.timestep_s)
        return self._rolled(s, initial, self.hypothesis)

    def rollout(self, windows: Windows) -> Array:
        return self.rollouts([windows])[0]

    def rollouts(self, windows: Sequence[Windows]) -> list[Array]:
        return side_by_side([self], [self.beginning(w) for w in windows], windows)[0]

    def gains(self) -> Array:
        """The gains of an episode's first samples and, the last, of all others, `(beginning,
        joints, 4, 2)`."""
        joints = len(self.plant.joints)
        return np.array(self.gain or ((0.0,) * 8 * joints,)).reshape(-1, joints, 4, 2)

    def beginning(self, windows: Windows) -> tuple[Series, Array]:
        """What a rollout of an episode's windows begins with, whatever the gain: the episode, each
        of whose windows starts from the filter of its past, and where that filter starts, `(1,
        states, BLOCK)`."""
        plant = self.plant
        series = whole(plant, windows.episode, self.scheme, windows.first, windows.initial)
        first = np.nan_to_num(past_states(plant, windows.episode, slice(1)))
        if self.known and not np.isfinite(positions_and_velocities(plant, windows.episode)[0, 1]):
            first[0, 1] = self.known.velocity(first[0, 0], series.issued[0, 0])
        return series, np.repeat(first[:, :, None], BLOCK, axis=2)

    def lanes(self) -> Array:
        """The block's vector in every lane, `(rows, BLOCK)`."""
        return np.repeat(np.array(self.values)[:, None], BLOCK, axis=1)

    def description(self) -> dict[str, Json]:
        acting: list[Json] = [
            {
                "effect": kind(t).name,
                **({"source": source} if (source := source_of(kind(t).name)) else {}),
                "joint": self.plant.joint_name(joint(t)),
                "parameters": {
                    name: self.values[row] for name, row in self.plant.block.rows_of(t).items()
                },
            }
            for t in self.hypothesis.effects
        ]
        names = self.plant.dynamics.parameter_names
        return {
            "parameters": dict(zip(names, self.values[: len(names)], strict=True)),
            "effects": acting,
            "scheme": {
                "alpha": self.scheme.alpha,
                "parts": self.scheme.parts,
                **({"ramped": True} if self.scheme.ramped else {}),
            },
            "gain": [list(row) for row in self.gain],
            "nearest": self.known.nearest if self.known else None,
        }

    def arrays(self) -> dict[str, Array]:
        return {"known": self.known.moments} if self.known else {}

    @staticmethod
    def restore(
        plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]
    ) -> Corrected:
        given: Any = description
        values = plant.block.nulls.copy()
        for i, name in enumerate(plant.dynamics.parameter_names):
            values[i] = float(given["parameters"][name])
        hypothesis = Hypothesis()
        for entry in given["effects"]:
            at = term(
                known_effect(entry["effect"], entry.get("source")).name,
                [plant.joint_name(j) for j in range(len(plant.joints))].index(
                    entry.get("joint", plant.joint_name(0))
                ),
            )
            hypothesis = hypothesis | at
            for name, row in plant.block.rows_of(at).items():
                values[row] = float(entry["parameters"][name])
        if not np.isfinite(
            values[[row for t in hypothesis.effects for row in plant.block.rows(t)]]
        ).all():
            raise ValueError("a parameter of an acting effect is not finite")
        declared = given["scheme"]
        ramped = bool(declared.get("ramped", False))  # an older model says nothing
        scheme = Scheme(float(declared["alpha"]), int(declared["parts"]), ramped)
        rows = tuple(tuple(float(x) for x in row) for row in given["gain"])
        if {len(row) for row in rows} - {8 * len(plant.joints)}:
            raise ValueError("a gain has eight numbers of each joint for each sample")
        known = (
            None
            if given["nearest"] is None
            else VelocityPrior(arrays["known"], int(given["nearest"]))
        )
        return Corrected(plant, hypothesis, tuple(float(x) for x in values), scheme, rows, known)


def side_by_side(
    models: Sequence[Corrected],
    beginnings: Sequence[tuple[Series, Array]],
    windows: Sequence[Windows],
) -> list[list[Array]]:
    """The `rollouts` of each of some models that differ in their gains alone, as many as their
    form's `filters`, each in lanes of its own; `beginnings` of the windows of each episode."""
    one = models[0]
    on = switches(one.hypothesis, len(one.plant.joints))
    gains = np.stack([model.gains() for model in models], axis=-1)
    stack = Stack.of([series for series, _ in beginnings])
    init = np.concatenate([init for _, init in beginnings])
    p = np.repeat(one.lanes()[None], len(beginnings), axis=0)

    def in_windows(part: Part, out: Array) -> list[Array]:
        lanes = [FILTERS + k for k in range(len(models))]
        return [out[:, :, lane][windows[part.first].rows] for lane in lanes]

    asked = RolloutOf(stack, p, init, gains)
    rolled = roll_parts(one.plant.form, on, asked, in_windows, alone=True)
    return [[of_episode[k] for of_episode in rolled] for k in range(len(models))]


@singledispatch
def _stepping(_: Dynamics, model: Corrected) -> Stepping:
    raise TypeError(type(model.plant.dynamics).__name__)


@_stepping.register
def _stepping_of_simulator(_: SimulatedDynamics, model: Corrected) -> Stepping:
    raise NotExportable(
        f"{model.plant.name} is a simulator of your own: its step has no graph",
        hint=TO_A_TARGET,
    )


@_stepping.register
def _stepping_of_family(dynamics: CompiledFamily, model: Corrected) -> Stepping:
    numbers = model.values[: len(dynamics.parameter_names)]
    return JointStep(dynamics.family, numbers, _effects_by_joint(model), model.scheme.alpha)


@_stepping.register
def _stepping_of_tree(dynamics: CompiledTree, model: Corrected) -> Stepping:
    tree = dynamics.tree
    numbers = np.array(model.values[: len(tree.parameters)])
    return TreeStep(
        tree.joints,
        TreeDynamics(tree.constants, numbers),
        _effects_by_joint(model),
        dynamics.form.sizes,
        model.scheme.alpha,
    )


def _effects_by_joint(model: Corrected) -> list[JointEffects]:
    """The effects that act at each joint, in their order."""
    in_order, plant = list(effects()), model.plant
    acting: list[list[Acting]] = [[] for _ in plant.joints]
    for t in sorted(model.hypothesis.effects, key=lambda t: in_order.index(kind(t).name)):
        rows = plant.block.rows_of(t)
        acting[joint(t)].append((kind(t), {name: model.values[row] for name, row in rows.items()}))
    return [
        JointEffects(some, float(scale), plant.timestep_s)
        for some, scale in zip(acting, plant.command_scales, strict=True)
    ]


@singledispatch
def _advance(_: Dynamics, model: Corrected, states: Array, applied: Array, span: Array) -> Array:
    """States after one step of `span` [s] `(n,)` each, compiled."""
    rows = [
        model.compiled_hold(state, u, np.array([0.0, float(h)]))[1]
        for state, u, h in zip(states, applied, span, strict=True)
    ]
    return np.stack(rows) if rows else states


@_advance.register
def _advance_family(
    _: CompiledFamily, model: Corrected, states: Array, applied: Array, span: Array
) -> Array:
    q: Columns = [states[:, 0]]
    v: Columns = [states[:, 1]]
    u = [applied[:, 0]]
    for _part in range(model.scheme.parts):
        q, v, _memory = model.stepping.advance(q, v, [{}], u, span / model.scheme.parts)
    return np.stack([*q, *v], axis=1)


@singledispatch
def _hold(_: Dynamics, model: Corrected, states: Array, issued: Array, steps: int) -> Array:
    """States after each of some declared steps, compiled as a whole."""
    applied = model.plant.applied(issued)
    t_s = np.asarray(np.arange(steps + 1) * model.plant.timestep_s, np.float64)
    return np.stack(
        [model.compiled_hold(state, u, t_s)[1:] for state, u in zip(states, applied, strict=True)]
    )


@_hold.register
def _hold_family(
    _: CompiledFamily, model: Corrected, states: Array, issued: Array, steps: int
) -> Array:
    return Predictor.hold(model, states, issued, steps)


@_advance.register
def _advance_simulator(
    _: SimulatedDynamics, model: Corrected, states: Array, applied: Array, span: Array
) -> Array:
    return _side_by_side(model, states, applied, span, 1)[:, 0]


@_hold.register
def _hold_simulator(
    _: SimulatedDynamics, model: Corrected, states: Array, issued: Array, steps: int
) -> Array:
    applied, span = model.plant.applied(issued), np.full(len(states), model.plant.timestep_s)
    return _side_by_side(model, states, applied, span, steps)


def _side_by_side(
    model: Corrected, states: Array, applied: Array, span: Array, steps: int
) -> Array:
    """States `(n, steps, states)` after each of some steps of `span` [s] `(n,)`, each from its own
    state, under a command of its own, and with hidden states as they begin."""
    series = []
    for u, h in zip(applied, span, strict=True):
        t_s = np.asarray(np.arange(steps + 1) * float(h), np.float64)
        commands = np.tile(u, (steps + 1, 1))
        s = unobserved(model.scheme, t_s, commands, model.plant.command_scales, float(h))
        series.append(s)
    p = np.repeat(model.lanes()[None], len(states), axis=0)
    asked = RolloutOf(Stack.of(series), p, np.repeat(states[:, :, None], BLOCK, axis=2))
    on = switches(model.acting, len(model.plant.joints))
    form = model.plant.form
    return np.stack(roll_parts(form, on, asked, lambda _, out: out[1:, :, 0], alone=True))
