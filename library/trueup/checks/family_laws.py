"""Laws of a family: its regressors are its derivative, every parameter matters, and its docstring
states equation and source."""

from __future__ import annotations

import inspect

import numpy as np

from trueup.checks.law import require
from trueup.model.family import Family

DIFFERENCE = 1e-9


def regressors_are_the_derivative(family: type[Family]) -> None:
    """The acceleration is the sum of parameter times regressor."""
    rng = np.random.default_rng(1)
    q, v, u = rng.normal(size=(3, 50))
    parameters = rng.normal(size=len(family.params))
    total = sum(p * r for p, r in zip(parameters, family.regressors(q, v, u), strict=True))
    require(
        np.allclose(total, family.acceleration(q, v, u, *parameters), atol=DIFFERENCE),
        "regressors are the derivative",
        family.name,
    )


def every_parameter_matters(family: type[Family]) -> None:
    """Changing any one parameter changes the acceleration."""
    rng = np.random.default_rng(2)
    q, v, u = rng.normal(size=(3, 50))
    base = np.ones(len(family.params))
    for i, param in enumerate(family.params):
        moved = base.copy()
        moved[i] += 0.5
        changed = (
            np.abs(family.acceleration(q, v, u, *moved) - family.acceleration(q, v, u, *base)).max()
            > DIFFERENCE
        )
        require(bool(changed), "every parameter matters", family.name, f"{param.name} does not")


def says_where_it_comes_from(family: type[Family]) -> None:
    """The docstring gives equation and source, and each parameter its unit."""
    text = inspect.getdoc(family) or ""
    require("Equation:" in text and "Source:" in text, "says where it comes from", family.name)
    require(
        all(p.unit for p in family.params),
        "says where it comes from",
        family.name,
        "a parameter has no unit",
    )


LAWS = (regressors_are_the_derivative, every_parameter_matters, says_where_it_comes_from)
