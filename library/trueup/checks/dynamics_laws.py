"""Laws of dynamics: the compiled rollout is the repeated numpy step, lane by lane; a step of no
length changes no state; inertia resists every force."""

from __future__ import annotations

import numpy as np

from trueup.checks.law import require
from trueup.model.dynamics import Array, Dynamics

VECTORS, WINDOWS, SAMPLES, H_S = 18, 3, 20, 0.01
# compiled code may order additions otherwise; a robot's motion multiplies the difference
ROUNDING = 1e-9


def compiled_equals_numpy(dynamics: Dynamics, parameters: Array, name: str) -> None:
    """The compiled rollout gives what the numpy step gives, step by step, for every lane;
    parameters `(VECTORS, parameters)`."""
    rng = np.random.default_rng(0)
    initial, applied = (
        rng.normal(size=(WINDOWS, 2 * dynamics.joints)),
        rng.normal(size=(WINDOWS, SAMPLES, dynamics.joints)),
    )
    steps = rng.integers(1, 3, (WINDOWS, SAMPLES))
    rolled_out = dynamics.rollout(
        parameters, initial, applied, np.full((WINDOWS, SAMPLES), H_S), steps
    )
    for vector in range(VECTORS):
        states = initial.copy()
        for i in range(SAMPLES):
            same = np.allclose(rolled_out[vector, :, i], states, rtol=ROUNDING, atol=ROUNDING)
            require(same, "compiled equals numpy", name, f"sample {i}, vector {vector}")
            for step in range(int(steps[:, i].max())):
                runs = steps[:, i] > step
                states[runs] = dynamics.step(
                    states[runs], applied[runs, i], parameters[vector], H_S
                )


def no_time_no_motion(dynamics: Dynamics, parameters: Array, name: str) -> None:
    """A step of no length leaves every state as it is."""
    state = np.random.default_rng(1).normal(size=(20, 2 * dynamics.joints))
    after = dynamics.step(state, np.ones((20, dynamics.joints)), parameters[0], 0.0)
    require(np.array_equal(after, state), "no time, no motion", name)


def inertia_resists(dynamics: Dynamics, parameters: Array, name: str) -> None:
    """Every mass matrix is symmetric where the joints' own inertias are taken out, and every force
    moves something its own way."""
    q = np.random.default_rng(2).normal(size=(20, dynamics.joints))
    masses = dynamics.inertia(parameters[0], q) * dynamics.form.sizes[None, :, None]
    require(
        np.allclose(masses, np.swapaxes(masses, 1, 2)),
        "inertia resists",
        name,
        "it is not symmetric",
    )
    require(
        bool((np.linalg.eigvalsh(masses) > 0.0).all()),
        "inertia resists",
        name,
        "it is not positive",
    )


LAWS = (compiled_equals_numpy, no_time_no_motion, inertia_resists)
