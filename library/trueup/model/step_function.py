"""Step function: a predictor of one joint as a function from a state and a command to an
observation and the next state.

The state is everything that the next step depends on: position, velocity, what effects remember,
and the commands that are still on their way. Samples are one declared period apart. It needs numpy
alone, and runs on symbols too (`trueup.artifact.onnx`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import Any

import numpy as np

from trueup.errors import NotExportable
from trueup.model.corrected import Corrected
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

State = Mapping[str, Any]  # by name
POSITION, VELOCITY, TIME = "position", "velocity", "time"
TINY = 1e-9  # of a period: rounding, not a delay


@dataclass(frozen=True)
class StepFunction:
    """`physics` steps, then `map` adds what it was found to miss; a map alone is all there is where
    there is no physics."""

    plant: Plant
    physics: Corrected | None
    map: LinearMap | None = None
    fed: Mapping[str, float] | None = None

    @staticmethod
    def of(predictor: Predictor) -> StepFunction:
        """The step function of a predictor of a family. Raises NotExportable for a robot given as
        MJCF."""
        plant = predictor.plant
        Corrected.of_numbers(plant, plant.parameters).joint  # noqa: B018  (raises)
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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the state's entries, in order."""
        return tuple(self.begin(0.0, 0.0, 0.0))

    @cached_property
    def shares(self) -> tuple[tuple[float, ...], ...]:
        """For each part of a step, how much each command counts, the newest first; one alone where
        nothing is late."""
        parts = self.physics.scheme.parts if self.physics else 1
        period, late = self.plant.timestep_s, self.physics.joint.lag_s if self.physics else 0.0
        held = ceil(late / period - TINY)
        by_part = []
        for part in range(parts):
            begin, end = (x * period / parts - late for x in (part, part + 1))
            overlaps = [
                max(min(end, (1 - k) * period) - max(begin, -k * period), 0.0)
                for k in range(held + 1)
            ]
            by_part.append(tuple(x / (end - begin) for x in overlaps))
        return tuple(by_part)

    def begin(self, position: Any, velocity: Any, command: Any) -> dict[str, Any]:
        """The state at an episode's first sample; the command, within its limits, has been the
        first one for ever."""
        state = {POSITION: position, VELOCITY: velocity}
        if self.physics is None:
            return state
        command = self._held(command)
        state |= self.physics.joint.begin(velocity, command)
        remembers = "actuator_delay" in self.physics.hypothesis.effects
        state |= {
            f"command {k} before": command if remembers else 0.0 * command
            for k in range(1, len(self.shares[0]))
        }
        return state | ({TIME: 0.0 * command} if self._asks_time else {})

    def step(self, state: State, command: Any) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """What is observed now, in the order of the plant's observations, and the next state, under
        a command held until then."""
        q, v, held = state[POSITION], state[VELOCITY], self._held(command)
        if self.physics is None:
            by = self._mapped(q, v, command)
            return self._observed(q, v), {POSITION: by[0], VELOCITY: by[1]}
        joint, period = self.physics.joint, self.plant.timestep_s
        late = [held, *(state[f"command {k} before"] for k in range(1, len(self.shares[0])))]
        memory: dict[str, Any] = {name: x for name, x in state.items() if "." in name}
        seen_q, seen_v, memory = joint.shown(q, v, memory, state.get(TIME, 0.0))
        by = self._mapped(q, v, command) if self.map else (0.0, 0.0)
        for share in self.shares:
            acting = sum(s * u for s, u in zip(share, late, strict=True) if s > 0.0)
            q, v, memory = joint.advance(q, v, memory, acting, period / len(self.shares))
        after = (
            {POSITION: q + by[0], VELOCITY: v + by[1]} if self.map else {POSITION: q, VELOCITY: v}
        )
        after |= {name: memory[name] for name in state if "." in name}
        after |= {f"command {k} before": u for k, u in enumerate(late[:-1], 1)}
        return self._observed(seen_q, seen_v), after | (
            {TIME: state[TIME] + period} if self._asks_time else {}
        )

    def _held(self, command: Any) -> Any:
        low, high = (float(bound[0]) for bound in self.plant.limits)
        return np.minimum(np.maximum(command, low), high)

    def _mapped(self, q: Any, v: Any, u: Any) -> tuple[Any, Any]:
        """What the map gives for position and velocity."""
        assert self.map is not None
        columns = {"q": [q], "v": [v], "u": [u]}
        values = [value(feature, columns, self.fed or {}) for feature in self.map.features]
        both = [
            sum(float(w) * x for w, x in zip(weights, values, strict=True))
            for weights in self.map.weights.T
        ]
        return both[0], both[1]

    def _observed(self, q: Any, v: Any) -> tuple[Any, ...]:
        return tuple((q, v)[column] for column in self.plant.state_columns)

    @cached_property
    def _asks_time(self) -> bool:
        return self.physics is not None and any(
            "t" in effect.arguments() for effect, _ in self.physics.joint.effects
        )
