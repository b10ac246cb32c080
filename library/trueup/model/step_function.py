"""Step function: a predictor as a function from a state and commands to observations and the next
state.

The state is everything that the next step depends on: positions, velocities, what effects remember,
commands that are still on their way, and motion that a late sensor has still to show. Samples are
one declared period apart. It needs numpy alone, and runs on symbols too (`trueup.artifact.onnx`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor
from typing import Any

import numpy as np

from trueup.errors import NotExportable
from trueup.model.corrected import Corrected
from trueup.model.effect import Port
from trueup.model.features import value
from trueup.model.plant import Plant
from trueup.model.predictor import (
    Blind,
    Conditioned,
    LinearMap,
    Nominal,
    Physical,
    Predictor,
    Residual,
)
from trueup.model.stepping import Columns, between

State = Mapping[str, Any]  # by name
POSITION, VELOCITY, TIME = "position", "velocity", "time"
STATES = POSITION, VELOCITY
TINY = 1e-9  # of a period: rounding, not a delay


@dataclass(frozen=True)
class StepFunction:
    """`physics` steps, then `map` adds what it was found to miss; a map alone is all there is where
    there is no physics. Commands and columns of a joint are `(n,)` each."""

    plant: Plant
    physics: Corrected | None
    map: LinearMap | None = None
    fed: Mapping[str, float] | None = None

    @staticmethod
    def of(predictor: Predictor) -> StepFunction:
        """The step function of a predictor. Raises NotExportable of a simulator."""
        plant = predictor.plant
        Corrected.of_numbers(plant, plant.parameters).stepping  # noqa: B018  (raises)
        match predictor:
            case Corrected():
                return StepFunction(plant, predictor)
            case Physical():
                return StepFunction(plant, Corrected.of_numbers(plant, predictor.parameters))
            case Residual():
                return StepFunction(
                    plant, Corrected.of_numbers(plant, Nominal(plant).parameters), predictor.map
                )
            case Conditioned():
                return StepFunction(
                    plant,
                    None,
                    predictor.map,
                    dict(zip(plant.dynamics.parameter_names, predictor.parameters, strict=True)),
                )
            case Blind():
                return StepFunction(plant, None, predictor.map)
        raise NotExportable(f"a predictor of the kind {predictor.kind!r} has no step of this form")

    @cached_property
    def labels(self) -> Sequence[str]:
        """What stands behind the names of each joint's states."""
        return Corrected.of_numbers(self.plant, self.plant.parameters).stepping.labels

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the state's entries, in order."""
        nothing = [0.0] * len(self.labels)
        return tuple(self.begin_held(nothing, nothing, nothing))

    @cached_property
    def shares(self) -> tuple[tuple[tuple[float, ...], ...], ...]:
        """For each part of a step and each joint, how much each of its commands counts, the newest
        first; one alone where nothing is late."""
        if self.physics is None:
            return (((1.0,),) * len(self.labels),)
        parts, stepping = self.physics.scheme.parts, self.physics.stepping
        period = self.plant.timestep_s
        by_part = []
        for part in range(parts):
            by_joint = []
            for effects in stepping.effects:
                late = effects.late_s(Port.COMMAND)
                late += 0.0 if stepping.sensor_is_late else effects.late_s(Port.OBSERVATION)
                begin, end = (x * period / parts - late for x in (part, part + 1))
                overlaps = [
                    max(min(end, (1 - k) * period) - max(begin, -k * period), 0.0)
                    for k in range(ceil(late / period - TINY) + 1)
                ]
                by_joint.append(tuple(x / (end - begin) for x in overlaps))
            by_part.append(tuple(by_joint))
        return tuple(by_part)

    def begin(self, positions: Columns, velocities: Columns, commands: Columns) -> dict[str, Any]:
        """The state at an episode's first sample; the commands, within their limits, have been the
        first ones for ever, and the velocities too."""
        return self.begin_held(positions, velocities, self._held(commands, positions))

    def begin_held(self, q: Columns, v: Columns, u: Columns) -> dict[str, Any]:
        """The state at an episode's first sample under what each joint gets of its commands; every
        entry is linear in positions, velocities and these."""
        state = dict(zip(self._all(POSITION), q, strict=True))
        state |= dict(zip(self._all(VELOCITY), v, strict=True))
        if self.physics is None:
            return state
        stepping, period = self.physics.stepping, self.plant.timestep_s
        for label, memory in zip(self.labels, stepping.begin(v, u), strict=True):
            state |= {f"{key}{label}": x for key, x in memory.items()}
        for j, label in enumerate(self.labels):
            known = stepping.effects[j].remembers_commands()
            for k in range(1, len(self.shares[0][j])):
                state[f"command {k} before{label}"] = u[j] if known else 0.0 * u[j]
        for j, label in enumerate(self.labels):
            for k in range(1, self._kept[j] + 1):
                state[f"position {k} before{label}"] = q[j] - k * period * v[j]
                state[f"velocity {k} before{label}"] = v[j]
        return state | ({TIME: 0.0 * u[0]} if self._asks_time else {})

    def step(self, state: State, commands: Columns) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """What is observed now, in the order of the plant's observations, and the next state, under
        commands held until then."""
        q, v = ([state[name] for name in self._all(x)] for x in (POSITION, VELOCITY))
        if self.physics is None:
            by_q, by_v = self._mapped(q, v, commands)
            return self._observed(q, v), self._state(by_q, by_v)
        stepping, joints = self.physics.stepping, range(len(self.labels))
        late = [
            [u, *self._past("command", j, len(self.shares[0][j]), state)]
            for j, u in enumerate(self._held(commands, q))
        ]
        memory = [
            {key: state[f"{key}{label}"] for key in keys}
            for label, keys in zip(self.labels, self._remembered, strict=True)
        ]
        shown = []
        for j in joints:
            *seen, memory[j] = stepping.effects[j].shown(
                *self._seen(j, q[j], v[j], state), memory[j], state.get(TIME, 0.0)
            )
            shown.append(seen)
        seen_q, seen_v = zip(*shown, strict=True)
        at, speed = q, v
        for by_joint in self.shares:
            acting = [
                sum(s * u for s, u in zip(share, late[j], strict=True) if s > 0.0)
                for j, share in enumerate(by_joint)
            ]
            h = self.plant.timestep_s / len(self.shares)
            at, speed, memory = stepping.advance(at, speed, memory, acting, h)  # type: ignore[assignment]
        if self.map:
            by_q, by_v = self._mapped(q, v, commands)
            at = [x + more for x, more in zip(at, by_q, strict=True)]
            speed = [x + more for x, more in zip(speed, by_v, strict=True)]
        after = self._state(at, speed)
        for j, label in enumerate(self.labels):
            after |= {f"{key}{label}": x for key, x in memory[j].items()}
            after |= {f"command {k} before{label}": u for k, u in enumerate(late[j][:-1], 1)}
            after |= self._older(j, q[j], v[j], state)
        after |= {TIME: state[TIME] + self.plant.timestep_s} if self._asks_time else {}
        return self._observed(seen_q, seen_v), {name: after[name] for name in state}

    def _all(self, what: str) -> list[str]:
        return [f"{what}{label}" for label in self.labels]

    def _state(self, q: Columns, v: Columns) -> dict[str, Any]:
        names = [*self._all(POSITION), *self._all(VELOCITY)]
        return dict(zip(names, [*q, *v], strict=True))

    @cached_property
    def _remembered(self) -> list[list[str]]:
        """Names of what is remembered of each joint."""
        assert self.physics is not None
        nothing = [0.0] * len(self.labels)
        return [list(keys) for keys in self.physics.stepping.begin(nothing, nothing)]

    def _past(self, what: str, j: int, count: int, state: State) -> list[Any]:
        """A joint's values 1 to `count` - 1 samples before."""
        return [state[f"{what} {k} before{self.labels[j]}"] for k in range(1, count)]

    @cached_property
    def _sensors_late_s(self) -> list[float]:
        """By how much each joint's sensor is late [s]."""
        assert self.physics is not None
        stepping = self.physics.stepping
        if not stepping.sensor_is_late:
            return [0.0] * len(stepping.effects)
        return [effects.late_s(Port.OBSERVATION) for effects in stepping.effects]

    @cached_property
    def _kept(self) -> list[int]:
        """How many older samples of each joint's motion its sensor has still to show."""
        period = self.plant.timestep_s
        return [floor(s / period + TINY) + 1 if s > 0.0 else 0 for s in self._sensors_late_s]

    def _seen(self, j: int, q: Any, v: Any, state: State) -> tuple[Any, Any]:
        """Where a late sensor saw a joint, by a cubic through two samples."""
        kept, span = self._kept[j], self.plant.timestep_s
        if not kept:
            return q, v
        moved = [
            [x, *self._past(what, j, kept + 1, state)]
            for what, x in zip(STATES, (q, v), strict=True)
        ]
        (q1, q0), (v1, v0) = (values[-2:] for values in moved)
        x = kept - self._sensors_late_s[j] / span
        return between(x, span, (q0, v0), (q1, v1))

    def _older(self, j: int, q: Any, v: Any, state: State) -> dict[str, Any]:
        """The motion that a late sensor has still to show, a sample later."""
        older: dict[str, Any] = {}
        if self._kept[j]:
            for what, newest in zip(STATES, (q, v), strict=True):
                values = [newest, *self._past(what, j, self._kept[j], state)]
                older |= {f"{what} {k} before{self.labels[j]}": x for k, x in enumerate(values, 1)}
        return older

    def _held(self, commands: Columns, q: Columns) -> list[Any]:
        """What each joint gets of commands, within their limits; 0 where it has none."""
        low, high = self.plant.limits
        return [
            np.minimum(np.maximum(commands[at], float(low[at])), float(high[at]))
            if at >= 0
            else 0.0 * q[j]
            for j, at in enumerate(self.plant.command_columns)
        ]

    def _mapped(self, q: Columns, v: Columns, u: Columns) -> tuple[list[Any], list[Any]]:
        """What the map gives for positions and velocities."""
        assert self.map is not None
        columns = {"q": q, "v": v, "u": u}
        values = [value(feature, columns, self.fed or {}) for feature in self.map.features]
        given = [
            sum(float(w) * x for w, x in zip(weights, values, strict=True))
            for weights in self.map.weights.T
        ]
        return given[: len(q)], given[len(q) :]

    def _observed(self, q: Columns, v: Columns) -> tuple[Any, ...]:
        return tuple([*q, *v][column] for column in self.plant.state_columns)

    @cached_property
    def _asks_time(self) -> bool:
        return self.physics is not None and any(
            e.asks(frozenset({"t"})) for e in self.physics.stepping.effects
        )
