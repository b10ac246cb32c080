"""Dry friction of a robot's joints, all at once, as plain functions that the compiled rollout
calls."""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable

from trueup.model.block import BLOCK
from trueup.model.rigid_body import lanes_of
from trueup.model.tree import SWEEPS

SETTLED = 1e-12  # [rad/s, m/s] a sweep that changes no velocity by more is the last


def acts(held: Any) -> Any:
    """Whether anything is held in any lane of `held` `(lanes,)`."""
    any_held = False
    for lane in range(BLOCK):
        any_held = any_held or held[lane] > 0.0
    return any_held


def project_friction(inverse_mass: Any, held: Any, v: Any, impulse: Any, by: Any) -> None:
    """Dry friction of all joints at once: `v` `(joints, lanes)` after impulses no larger than
    `held`, each of which only ever stops its joint.

    `inverse_mass` is `(joints, joints x lanes)`; `impulse` `(joints, lanes)` and `by` `(lanes,)`
    are room for work. Source: J. J. Moreau (1988); the sweeps: M. Jean, Computer Methods in Applied
    Mechanics and Engineering 177 (1999).
    """
    n = len(held)
    several = 0
    for j in range(n):
        several += 1 if acts(held[j]) else 0
        for lane in range(BLOCK):
            impulse[j, lane] = 0.0
    for _ in range(SWEEPS if several > 1 else several):
        largest = 0.0
        for j in range(n):
            if not acts(held[j]):
                continue
            own, most = inverse_mass[j, lanes_of(j)], held[j]
            for lane in range(BLOCK):
                wanted = impulse[j, lane] - v[j, lane] / own[lane]
                wanted = min(max(wanted, -most[lane]), most[lane])
                by[lane] = wanted - impulse[j, lane]
                impulse[j, lane] = wanted
                largest = max(largest, abs(by[lane]) * own[lane])
            for k in range(n):
                there, coupled = v[k], inverse_mass[k, lanes_of(j)]
                for lane in range(BLOCK):
                    there[lane] += coupled[lane] * by[lane]
        if largest < SETTLED:
            break


for _function in (acts, project_friction):
    register_jitable(_function)  # compiled into what calls them
