"""A robot's step: the joints of a tree with their effects, which forces and friction tie together.

It does in numpy what the compiled rollout does (`kernel.py`), in the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.effect import Effect, Port
from trueup.model.joint_effects import PARTS, JointEffects, Memory, answers_all
from trueup.model.stepping import After, Columns, Stepping
from trueup.model.tree import DAMPING, FRICTION, GAIN, OFFSET, SERVO
from trueup.model.tree_dynamics import TreeDynamics, inverse, times

Array = NDArray[np.float64]
LAST_FORCE = "effects' last force"  # by which a symmetric step foresees its middle's velocity


@dataclass(frozen=True)
class TreeStep(Stepping):
    """A tree's dynamics, its joints' effects, and the inertias `(joints,)` by which their forces
    are divided. `alpha` is the scheme of integration, 0 the declared one and 1/2 its symmetric
    form."""

    names: Sequence[str]
    dynamics: TreeDynamics
    effects: Sequence[JointEffects]
    sizes: Array
    alpha: float
    sensor_is_late = True

    @property
    def labels(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(f"({name})" for name in self.names)

    @cached_property
    def _foresees(self) -> bool:
        return self.alpha > 0.0 and any(e.has(Port.FORCE) for e in self.effects)

    def begin(self, v: Columns, u: Columns) -> list[dict[str, Any]]:
        return [
            e.begin(speed, command) | ({LAST_FORCE: 0.0 * command} if self._foresees else {})
            for e, speed, command in zip(self.effects, v, u, strict=True)
        ]

    def advance(
        self, q: Columns, v: Columns, memory: Sequence[Memory], u: Columns, h: Any
    ) -> After:
        kept = [dict(m) for m in memory]
        signals: list[dict[str, Any]] = [
            {
                "u": command,
                "h": h,
                "u_scale": e.u_scale,
                "period": e.period_s,
                "implicit": 1.0 - 2.0 * self.alpha,
            }
            for command, e in zip(u, self.effects, strict=True)
        ]
        self.effects[0].change(Port.TIMING, signals[0], kept[0])  # one clock for all joints
        h = signals[0]["h"]
        for j, s in enumerate(signals):
            middle = q[j] + self.alpha * h * v[j]
            s |= {"h": h, "q": q[j], "v": v[j]}
            self._command(j, s, kept[j], middle)
            s["q"] = middle
        span = np.asarray(h)[:, None] if np.ndim(h) else h
        speeds = np.stack(list(v), -1)
        inverse_mass, nominal = self._accelerate(signals, kept, speeds, span)
        self._push(signals, kept, inverse_mass, nominal)
        after = self._brake(signals, kept, inverse_mass, speeds, span)
        joints = range(len(signals))
        moved = [signals[j]["q"] + (1.0 - self.alpha) * h * after[..., j] for j in joints]
        return moved, [after[..., j] for j in joints], kept

    def _command(self, j: int, s: dict[str, Any], kept: dict[str, Any], middle: Any) -> None:
        """The command that a joint's actuator gets. Effects change a servo's goal, or its drive,
        which acts on the error at the step's middle."""
        servo, gain = (self.dynamics.at_joint[..., j, k] for k in (SERVO, GAIN))
        if not np.any(servo):
            self.effects[j].change(Port.COMMAND, s, kept)
            return
        holding = (servo * middle - self.dynamics.constants[j, OFFSET]) / gain
        self.effects[j].change(Port.COMMAND, s, kept, lambda e: not e.of_drive)
        s["u"] = s["u"] - holding
        self.effects[j].change(Port.COMMAND, s, kept, lambda e: e.of_drive)
        s["u"] = s["u"] + holding

    def _accelerate(
        self, signals: list[dict[str, Any]], kept: list[dict[str, Any]], v: Any, h: Any
    ) -> tuple[Any, Any]:
        """The inverse mass matrix `(joints, joints)` and the nominal forces `(joints,)`, which
        signals get as accelerations, with the parts that effects ask for."""
        dynamics, joints = self.dynamics, range(len(signals))
        q, u = (np.stack([s[name] for s in signals], -1) for name in ("q", "u"))
        at = dynamics.links(q)
        damping = dynamics.diagonal(DAMPING)
        spread = h[..., None] if np.ndim(h) else h
        mass = dynamics.mass(at) + (1.0 - self.alpha) * spread * damping
        inverse_mass = inverse(mass, len(signals))
        drive = dynamics.drive(u, q)
        middle, force = v, drive + dynamics.passive(q, v) - dynamics.bias(at, v)
        if self.alpha > 0.0:
            ahead = force
            if self._foresees:
                ahead = force + np.stack([m[LAST_FORCE] for m in kept], -1)
            middle = v + self.alpha * h * times(inverse_mass, ahead)
            # damping takes the velocity of the step's end, see the mass matrix
            force = drive + dynamics.passive(q, v) - dynamics.bias(at, middle)
        for j in joints:
            signals[j] |= {"v": middle[..., j], "a": force[..., j] / self.sizes[j]}
        if any(e.asks(PARTS) for e in self.effects):
            at_rest = dynamics.passive(q, 0.0 * v) - dynamics.bias(at, middle)
            accelerations = times(inverse_mass, force)
            for j in joints:
                mobility, driven = inverse_mass[..., j, j] * self.sizes[j], drive[..., j]
                driven = driven / self.sizes[j]
                signals[j] |= {
                    "drive": driven,
                    "spring": at_rest[..., j] / self.sizes[j],
                    "mobility": mobility,
                    "passive": accelerations[..., j] / mobility - driven,
                }
        return inverse_mass, force

    def _push(
        self,
        signals: list[dict[str, Any]],
        kept: list[dict[str, Any]],
        inverse_mass: Any,
        nominal: Any,
    ) -> None:
        """Let effects change the accelerations; those that answer all others come last."""
        joints = range(len(signals))

        def first(effect: type[Effect]) -> bool:
            return not answers_all(effect)

        for j in joints:
            self.effects[j].change(Port.FORCE, signals[j], kept[j], first)
        pushed = [signals[j]["a"] * self.sizes[j] - nominal[..., j] for j in joints]
        for j in joints:
            if any(answers_all(e) for e, _ in self.effects[j].acting):
                through = sum(inverse_mass[..., j, k] * pushed[k] for k in joints if k != j)
                signals[j]["passive"] = signals[j]["passive"] + through / signals[j]["mobility"]
                self.effects[j].change(Port.FORCE, signals[j], kept[j], answers_all)
            if self._foresees:
                kept[j][LAST_FORCE] = signals[j]["a"] * self.sizes[j] - nominal[..., j]

    def _brake(
        self,
        signals: list[dict[str, Any]],
        kept: list[dict[str, Any]],
        inverse_mass: Any,
        v: Any,
        h: Any,
    ) -> Any:
        """Velocities `(joints,)` at the step's end."""
        dynamics, joints = self.dynamics, range(len(signals))
        a = np.stack([s["a"] for s in signals], -1)
        free = v + h * times(inverse_mass, a * self.sizes)
        own = set(dynamics.rubbing())
        rubs = [j for j in joints if j in own or self.effects[j].has(Port.FRICTION)]
        if not rubs:
            return free
        levels = [
            self.effects[j].friction(signals[j], kept[j]) + 0.0 * signals[j]["a"] for j in joints
        ]
        held = h * (np.stack(levels, -1) * self.sizes + dynamics.at_joint[..., FRICTION])
        return dynamics.braked(inverse_mass, held, free, rubs)
