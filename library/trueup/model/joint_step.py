"""One joint's step: a family's nominal form with its effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueup.model.effect import Port
from trueup.model.family import Family
from trueup.model.joint_effects import JointEffects, Memory
from trueup.model.stepping import After, Columns, Stepping


@dataclass(frozen=True)
class JointStep(Stepping):
    """A family with its numbers and effects. `alpha` is the scheme of integration, 0 the declared
    one and 1/2 its symmetric form."""

    family: type[Family]
    numbers: Sequence[float]
    effects: Sequence[JointEffects]
    alpha: float
    labels = ("",)
    sensor_is_late = False

    def begin(self, v: Columns, u: Columns) -> list[dict[str, Any]]:
        return [self.effects[0].begin(v[0], u[0])]

    def advance(
        self, q: Columns, v: Columns, memory: Sequence[Memory], u: Columns, h: Any
    ) -> After:
        alpha, acceleration, effects = self.alpha, self.family.acceleration, self.effects[0]
        kept = dict(memory[0])
        signals: dict[str, Any] = {
            "u": u[0],
            "h": h,
            "q": q[0],
            "v": v[0],
            "u_scale": effects.u_scale,
            "period": effects.period_s,
            "implicit": 1.0 - 2.0 * alpha,
            "mobility": 1.0,
        }
        for port in (Port.TIMING, Port.COMMAND):
            effects.change(port, signals, kept)
        command, h = signals["u"], signals["h"]
        position = q[0] + alpha * h * v[0]
        at = v[0] + alpha * h * acceleration(position, v[0], command, *self.numbers)
        a, passive, spring = (
            acceleration(position, s, c, *self.numbers)
            for s, c in ((at, command), (at, 0.0), (0.0, 0.0))
        )
        signals |= {
            "q": position,
            "v": at,
            "a": a,
            "passive": passive,
            "drive": a - passive,
            "spring": spring,
        }
        effects.change(Port.FORCE, signals, kept)
        free = v[0] + h * signals["a"]
        braked = np.maximum(np.abs(free) - h * effects.friction(signals, kept), 0.0)
        after = np.copysign(braked, free)
        return [position + (1.0 - alpha) * h * after], [after], [kept]
