"""Effects at a joint: those that act there, with their numbers, in the order in which they act, on
whatever numpy's functions can be called with.

The same text runs on arrays, and on symbols that write down what is done with them. It is the
reference of the compiled ports (`ports.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trueup.model.effect import Effect, Port

# What effects remember, by effect.state; what is not there begins with the signal that it follows
Memory = Mapping[str, Any]
Acting = tuple[type[Effect], Mapping[str, float]]
SIGNAL = {Port.TIMING: "h", Port.COMMAND: "u", Port.FORCE: "a"}
PARTS = frozenset({"passive", "drive", "spring", "mobility"})  # of the nominal acceleration


def answers_all(effect: type[Effect]) -> bool:
    """Whether an effect answers all other forces at its joint, and so comes after them."""
    return effect.port is Port.FORCE and "passive" in effect.arguments()


@dataclass(frozen=True, slots=True)
class JointEffects:
    """The effects that act at a joint; `u_scale` is its command's declared limit, `period_s` that
    of the samples."""

    acting: Sequence[Acting]
    u_scale: float
    period_s: float

    def late_s(self, port: Port) -> float:
        """By how much the command is late, or what the sensor shows [s]."""
        late = 0.0
        for effect, values in self.acting:
            if effect.delays() and effect.port is port:
                given = {"lag_s": late, "past": 0.0, "period": self.period_s, **values}
                after = effect.apply(*(given[name] for name in effect.arguments()))
                late = after[0] if effect.states else after
        return float(late)

    def remembers_commands(self) -> bool:
        """Whether the command before the log began is estimated."""
        return any(e.delays() and e.port is Port.COMMAND and e.states for e, _ in self.acting)

    def asks(self, signals: frozenset[str]) -> bool:
        """Whether an effect takes one of these signals."""
        return any(signals.intersection(e.arguments()) for e, _ in self.acting)

    def has(self, port: Port) -> bool:
        """Whether an effect acts at a port."""
        return any(e.port is port for e, _ in self.acting)

    def begin(self, v: Any, u: Any) -> dict[str, Any]:
        """What each effect remembers at the beginning, at a velocity and under a first command."""
        usual = {"zero": 0.0 * u, "u": u, "first": v}
        return {
            f"{e.name}.{state}": usual[begins]
            for e, _ in self.acting
            if not e.delays()
            for state, begins in zip(e.states, e.begins, strict=True)
        }

    def change(
        self,
        port: Port,
        signals: dict[str, Any],
        memory: dict[str, Any],
        which: Callable[[type[Effect]], bool] = lambda _: True,
    ) -> None:
        """Let the effects of a port change its signal, and what they remember."""
        for effect, values in self._at(port):
            if which(effect):
                after = effect.apply(*_arguments(effect, values, signals, memory))
                signals[SIGNAL[port]] = after[0] if effect.states else after
                memory |= _remembered(effect, after[1:] if effect.states else ())

    def friction(self, signals: Mapping[str, Any], memory: Memory) -> Any:
        """The level of dry friction, as an acceleration."""
        level: Any = 0.0
        for effect, values in self._at(Port.FRICTION):
            level = level + effect.apply(*_arguments(effect, values, signals, memory))
        return level

    def shown(self, q: Any, v: Any, memory: Memory, t: Any) -> tuple[Any, Any, dict[str, Any]]:
        """Position and velocity as they are observed at a sample, `t` [s] since the episode began,
        and memory."""
        signals, kept = {"q": q, "v": v, "t": t, "since": self.period_s}, dict(memory)
        for effect, values in self._at(Port.OBSERVATION):
            after = effect.apply(*_arguments(effect, values, signals, kept))
            signals["q"], signals["v"] = after[:2]
            kept |= _remembered(effect, after[2:])
        return signals["q"], signals["v"], kept

    def _at(self, port: Port) -> list[Acting]:
        return [(e, values) for e, values in self.acting if e.port is port and not e.delays()]


def _remembered(effect: type[Effect], states: Sequence[Any]) -> dict[str, Any]:
    return {f"{effect.name}.{name}": x for name, x in zip(effect.states, states, strict=True)}


def _arguments(
    effect: type[Effect], values: Mapping[str, float], signals: Mapping[str, Any], memory: Memory
) -> list[Any]:
    """What an effect is called with."""

    def value(name: str) -> Any:
        if name in values:
            return values[name]
        if name not in effect.states:
            return signals[name]
        key = f"{effect.name}.{name}"
        if key in memory:
            return memory[key]
        begins = effect.begins[effect.states.index(name)]
        return 0.0 * signals["u"] if begins == "zero" else signals[begins]

    return [value(name) for name in effect.arguments()]
