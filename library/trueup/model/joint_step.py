"""Stepping: one joint's nominal form with its effects, a step at a time, by numpy's functions on
whatever they can be called with.

The same text runs on arrays, and on symbols that write down what is done with them. It is the
compiled rollout's reference: each effect's own function, in the order in which effects act.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from trueup.model.effect import Effect, Port
from trueup.model.family import Family

# What effects remember, by effect.state; what is not there begins with the signal that it follows
Memory = Mapping[str, Any]
SIGNAL = {Port.TIMING: "h", Port.COMMAND: "u", Port.FORCE: "a"}


@dataclass(frozen=True)
class Joint:
    """A family with its numbers, and the effects that act with theirs, in their order.

    `alpha` is the scheme of integration, 0 the declared one and 1/2 its symmetric form; `u_scale`
    the command's declared limit; `period_s` that of the samples.
    """

    family: type[Family]
    numbers: Sequence[float]
    effects: Sequence[tuple[type[Effect], Mapping[str, float]]]
    alpha: float
    u_scale: float
    period_s: float

    @cached_property
    def lag_s(self) -> float:
        """By how much the command is late in all [s]; on the log of one joint a late sensor is a
        late drive."""
        lag_s = 0.0
        for effect, values in self.effects:
            if effect.delays():
                given = {"lag_s": lag_s, "past": 0.0, "period": self.period_s, **values}
                after = effect.apply(*(given[name] for name in effect.arguments()))
                lag_s = after[0] if effect.states else after
        return float(lag_s)

    def begin(self, v: Any, u: Any) -> dict[str, Any]:
        """What each effect remembers at the beginning, at a velocity and under a first command."""
        usual = {"zero": 0.0 * u, "u": u, "first": v}
        return {
            f"{e.name}.{state}": usual[begins]
            for e, _ in self.effects
            if not e.delays()
            for state, begins in zip(e.states, e.begins, strict=True)
        }

    def advance(
        self, q: Any, v: Any, memory: Memory, u: Any, h: Any
    ) -> tuple[Any, Any, dict[str, Any]]:
        """Position, velocity and memory `h` [s] later, under a command that is late already where
        it is late."""
        alpha, acceleration, kept = self.alpha, self.family.acceleration, dict(memory)
        signals: dict[str, Any] = {
            "u": u,
            "h": h,
            "q": q,
            "v": v,
            "u_scale": self.u_scale,
            "period": self.period_s,
        }
        signals |= {"implicit": 1.0 - 2.0 * alpha, "mobility": 1.0}
        for port in (Port.TIMING, Port.COMMAND):
            self._act(port, signals, kept)
        u, h = signals["u"], signals["h"]
        q = q + alpha * h * v
        at = v + alpha * h * acceleration(q, v, u, *self.numbers)
        a, passive, spring = (
            acceleration(q, s, c, *self.numbers) for s, c in ((at, u), (at, 0.0), (0.0, 0.0))
        )
        signals |= {
            "q": q,
            "v": at,
            "a": a,
            "passive": passive,
            "drive": a - passive,
            "spring": spring,
        }
        self._act(Port.FORCE, signals, kept)
        level: Any = 0.0
        for effect, values in self._at(Port.FRICTION):
            level = level + effect.apply(
                *(_value(effect, values, name, signals, kept) for name in effect.arguments())
            )
        free = v + h * signals["a"]
        after = np.copysign(np.maximum(np.abs(free) - h * level, 0.0), free)
        return q + (1.0 - alpha) * h * after, after, kept

    def shown(self, q: Any, v: Any, memory: Memory, t: Any) -> tuple[Any, Any, dict[str, Any]]:
        """Position and velocity as they are observed at a sample, `t` [s] since the episode began,
        and memory."""
        signals, kept = {"q": q, "v": v, "t": t, "since": self.period_s}, dict(memory)
        for effect, values in self._at(Port.OBSERVATION):
            after = effect.apply(
                *(_value(effect, values, name, signals, kept) for name in effect.arguments())
            )
            signals["q"], signals["v"] = after[:2]
            kept |= {
                f"{effect.name}.{state}": value
                for state, value in zip(effect.states, after[2:], strict=True)
            }
        return signals["q"], signals["v"], kept

    def _at(self, port: Port) -> list[tuple[type[Effect], Mapping[str, float]]]:
        return [
            (effect, values)
            for effect, values in self.effects
            if effect.port is port and not effect.delays()
        ]

    def _act(self, port: Port, signals: dict[str, Any], memory: dict[str, Any]) -> None:
        for effect, values in self._at(port):
            after = effect.apply(
                *(_value(effect, values, name, signals, memory) for name in effect.arguments())
            )
            signals[SIGNAL[port]] = after[0] if effect.states else after
            if effect.states:
                memory |= {
                    f"{effect.name}.{state}": value
                    for state, value in zip(effect.states, after[1:], strict=True)
                }


def _value(
    effect: type[Effect],
    values: Mapping[str, float],
    name: str,
    signals: Mapping[str, Any],
    memory: Memory,
) -> Any:
    if name in values:
        return values[name]
    if name not in effect.states:
        return signals[name]
    key = f"{effect.name}.{name}"
    if key in memory:
        return memory[key]
    begins = effect.begins[effect.states.index(name)]
    return 0.0 * signals["u"] if begins == "zero" else signals[begins]
