"""Corrected: the nominal form with the numbers and effects that a diagnosis found.

A rollout starts from a filter that ran over the episode's past: the same model, corrected by each observation with a gain that
soon is constant. So lag, play, heat and hysteresis have the past that they need, and noise of the starting sample is averaged out. Where no
velocity is observed, an episode's first is the one known from like positions and commands.
Source of the gain: R. E. Kalman, Journal of Basic Engineering 82 (1960).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.model.block import BLOCK, layout, nulls, rows_of
from trueup.model.dynamics import CompiledFamily
from trueup.model.effect import Effect, Port, effects
from trueup.model.family import Family, families
from trueup.model.hypothesis import Hypothesis, switches
from trueup.model.known import Known
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.model.series import Scheme, position_and_velocity, roll, whole
from trueup.model.state import past_states
from trueup.model.windows import Windows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Corrected(Predictor):
    """A family with effects.

    `values` is the block's vector; `gain` `(beginning, 4, 2)` corrects position, velocity, a disturbing acceleration and what hides the
    velocity by an observed position and velocity, at each of an episode's first samples and, the last, at all others; `known` moments
    tell a first velocity that nobody observed.
    """

    plant: Plant
    hypothesis: Hypothesis
    values: tuple[float, ...]
    scheme: Scheme
    gain: tuple[tuple[float, ...], ...] = ((0.0,) * 8,)  # a row for each sample
    known: Known | None = None
    kind = "corrected"

    @property
    def family(self) -> type[Family]:
        """The nominal form."""
        return _family(self.plant)

    def predict_batch(self, states: Array, issued: Array, h_s: Array | float | None = None) -> Array:
        """One step of the symmetric or declared scheme in numpy, with hidden states as they begin: the kernel's reference."""
        span = np.broadcast_to(self.plant.timestep_s if h_s is None else h_s, len(states))
        moved = states
        for _ in range(self.scheme.parts):
            moved = _step(self, moved, self.plant.applied(issued)[:, 0], span / self.scheme.parts)
        return moved

    def rollout(self, windows: Windows) -> Array:
        series = whole(self.plant, windows.episode, self.scheme, windows.first)
        p = np.repeat(np.array(self.values)[:, None], BLOCK, axis=1)
        first = np.nan_to_num(past_states(self.plant, windows.episode)[:1])
        if self.known and not np.isfinite(position_and_velocity(self.plant, windows.episode)[0, 1]):
            first[0, 1] = self.known.velocity(first[0, 0], series.issued[0])
        init = np.repeat(first[:, :, None], BLOCK, axis=2)
        family = list(families()).index(self.family.name)
        out = roll(series, family, p, switches(self.hypothesis), init, np.array(self.gain).reshape(-1, 4, 2))
        return np.asarray(out[windows.rows][:, :, :, 1])

    def description(self) -> dict[str, Json]:
        found: list[Json] = [
            {"effect": e, "parameters": {name: self.values[row] for name, row in rows_of(e).items()}} for e in self.hypothesis.effects
        ]
        names = self.plant.dynamics.parameter_names
        return {
            "parameters": dict(zip(names, self.values[: len(names)], strict=True)),
            "effects": found,
            "scheme": {"alpha": self.scheme.alpha, "parts": self.scheme.parts},
            "gain": [list(row) for row in self.gain],
            "nearest": self.known.nearest if self.known else None,
        }

    def arrays(self) -> dict[str, Array]:
        return {"known": self.known.moments} if self.known else {}

    @staticmethod
    def restore(plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]) -> Corrected:
        given: Any = description
        values = nulls().copy()
        for i, name in enumerate(plant.dynamics.parameter_names):
            values[i] = float(given["parameters"][name])
        for entry in given["effects"]:
            for name, row in rows_of(entry["effect"]).items():
                values[row] = float(entry["parameters"][name])
        hypothesis = Hypothesis(tuple(entry["effect"] for entry in given["effects"]))
        if not np.isfinite(values[list(_rows(hypothesis))]).all():
            raise ValueError("a parameter of an acting effect is not finite")
        scheme = Scheme(float(given["scheme"]["alpha"]), int(given["scheme"]["parts"]))
        rows = tuple(tuple(float(x) for x in row) for row in given["gain"])
        if {len(row) for row in rows} != {8}:
            raise ValueError("a gain has eight numbers for each sample")
        known = None if given["nearest"] is None else Known(arrays["known"], int(given["nearest"]))
        return Corrected(plant, hypothesis, tuple(float(x) for x in values), scheme, rows, known)


def _family(plant: Plant) -> type[Family]:
    assert isinstance(plant.dynamics, CompiledFamily)
    return plant.dynamics.family


def _rows(hypothesis: Hypothesis) -> tuple[int, ...]:
    return tuple(row for name in hypothesis.effects for row in layout()[name])


def _step(model: Corrected, states: Array, u: Array, h: Array) -> Array:
    """One step, each effect's own function on arrays."""
    plant, alpha = model.plant, model.scheme.alpha
    family = model.values[: len(plant.dynamics.parameter_names)]
    acceleration = model.family.acceleration
    zero = np.zeros(len(states))
    scale = float(np.max(np.abs(plant.limits)))
    signals: dict[str, Any] = {"u": u, "h": h, "t": zero, "u_scale": scale, "period": plant.timestep_s, "lag_s": zero}
    signals["implicit"] = 1.0 - 2.0 * alpha
    signals |= {"q": states[:, 0], "v": states[:, 1], "level": zero}
    acting = [effects()[name] for name in effects() if name in model.hypothesis.effects]
    _act(model, acting, Port.TIMING, signals)
    _act(model, acting, Port.COMMAND, signals)
    q, v, u, h = states[:, 0], states[:, 1], signals["u"], signals["h"]
    q = q + alpha * h * v
    at = v + alpha * h * acceleration(q, v, u, *family)
    a, passive, spring = (acceleration(q, s, c, *family) for s, c in ((at, u), (at, 0.0), (0.0, 0.0)))
    signals |= {"q": q, "v": at, "a": a, "passive": passive, "drive": a - passive, "spring": spring}
    _act(model, acting, Port.FORCE, signals)
    for effect in (e for e in acting if e.port is Port.FRICTION):
        signals["level"] = signals["level"] + effect.apply(*(_value(model, effect, name, signals) for name in effect.arguments()))
    free = v + h * signals["a"]
    after = np.copysign(np.maximum(np.abs(free) - h * signals["level"], 0.0), free)
    return np.stack([q + (1.0 - alpha) * h * after, after], axis=1)


def _act(model: Corrected, acting: list[type[Effect]], port: Port, signals: dict[str, Any]) -> None:
    for effect in acting:
        if effect.port is port and not effect.delays():
            result = effect.apply(*(_value(model, effect, name, signals) for name in effect.arguments()))
            name = {Port.TIMING: "h", Port.COMMAND: "u", Port.FORCE: "a"}[port]
            signals[name] = result[0] if effect.states else result


def _value(model: Corrected, effect: type[Effect], name: str, signals: Mapping[str, Any]) -> Any:
    rows = rows_of(effect.name)
    if name in rows:
        return model.values[rows[name]]
    if name in effect.states:
        begins = effect.begins[effect.states.index(name)]
        return 0.0 * signals["u"] if begins == "zero" else signals[begins]
    return signals[name]
