"""Laws of a family: its text means the same everywhere, its regressors are its derivative, and it says where it comes from."""

from __future__ import annotations

import inspect

import numpy as np

from trueup.checks.law import require
from trueup.model.dynamics import CompiledFamily
from trueup.model.family import Family

VECTORS, WINDOWS, SAMPLES, H_S = 21, 3, 40, 0.01
ROUNDING = 1e-12  # compiled code may order additions otherwise
DIFFERENCE = 1e-9


def compiled_equals_numpy(family: type[Family]) -> None:
    """The compiled rollout gives what the numpy step gives, step by step, for every lane."""
    dynamics, rng = CompiledFamily(family), np.random.default_rng(0)
    parameters = rng.uniform(0.2, 1.5, (VECTORS, len(family.params)))
    initial, applied = rng.normal(size=(WINDOWS, 2)), rng.normal(size=(WINDOWS, SAMPLES, 1))
    steps = rng.integers(1, 3, (WINDOWS, SAMPLES))
    found = dynamics.rollout(parameters, initial, applied, np.full((WINDOWS, SAMPLES), H_S), steps)
    for vector in range(VECTORS):
        for window in range(WINDOWS):
            state = initial[window : window + 1]
            for i in range(SAMPLES):
                same = np.allclose(found[vector, window, i], state[0], rtol=ROUNDING, atol=ROUNDING)
                require(same, "compiled equals numpy", family.name, f"sample {i} of window {window}, vector {vector}")
                for _ in range(steps[window, i]):
                    state = dynamics.step(state, applied[window, i : i + 1], parameters[vector], H_S)


def regressors_are_the_derivative(family: type[Family]) -> None:
    """The acceleration is the sum of parameter times regressor."""
    rng = np.random.default_rng(1)
    q, v, u = rng.normal(size=(3, 50))
    parameters = rng.normal(size=len(family.params))
    total = sum(p * r for p, r in zip(parameters, family.regressors(q, v, u), strict=True))
    require(np.allclose(total, family.acceleration(q, v, u, *parameters), atol=DIFFERENCE), "regressors are the derivative", family.name)


def every_parameter_matters(family: type[Family]) -> None:
    """Changing any one parameter changes the acceleration."""
    rng = np.random.default_rng(2)
    q, v, u = rng.normal(size=(3, 50))
    base = np.ones(len(family.params))
    for i, param in enumerate(family.params):
        moved = base.copy()
        moved[i] += 0.5
        changed = np.abs(family.acceleration(q, v, u, *moved) - family.acceleration(q, v, u, *base)).max() > DIFFERENCE
        require(bool(changed), "every parameter matters", family.name, f"{param.name} does not")


def says_where_it_comes_from(family: type[Family]) -> None:
    """The docstring gives equation and source, and each parameter its unit."""
    text = inspect.getdoc(family) or ""
    require("Equation:" in text and "Source:" in text, "says where it comes from", family.name)
    require(all(p.unit for p in family.params), "says where it comes from", family.name, "a parameter has no unit")


LAWS = (compiled_equals_numpy, regressors_are_the_derivative, every_parameter_matters, says_where_it_comes_from)
