"""Declared features of a linear map: products of the plant's symbols.

A feature is written as factors with `*` between them: `1`, `q`, `v`, `u`, `q*v`, `q*q`, `sign(v)`,
`abs(v)`, `k*q`. The symbols are `q`, `v` of the first joint, its issued command `u`, those of
further joints and commands with their number, `q1`, `sign(v2)`, and the plant's parameters by name.
Nothing is evaluated: an unknown factor is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadArtifact
from trueup.model.dynamics import Dynamics

Array = NDArray[np.float64]

POLYNOMIAL = ("q", "v", "u", "q*v", "q*u", "v*u", "q*q", "v*v", "u*u", "1")
FRICTION = ("1", "v", "u", "sign(v)", "abs(v)")

_FACTOR = re.compile(r"(?:(sign|abs|sin)\(([qvu])(\d{0,3})\)|([qvu])(\d{0,3}))")
_FUNCTIONS: Mapping[str, Callable[[Any], Any]] = {"sign": np.sign, "abs": np.abs, "sin": np.sin}
_WORDS = (
    "1, q, v, u, sign(v), abs(v), sin(q) with a joint's number behind the letter where it "
    "is not the first"
)


def polynomial(joints: int, commands: int = 1) -> tuple[str, ...]:
    """Features of a residual where none are asked for: a polynomial of one joint, of several each
    one's own motion and dry friction."""
    if joints == 1:
        return POLYNOMIAL
    counts = {
        "q{}": joints,
        "v{}": joints,
        "u{}": commands,
        "sign(v{})": joints,
        "abs(v{})": joints,
    }
    return ("1", *(form.format(i or "") for form, count in counts.items() for i in range(count)))


def conditioned(dynamics: Dynamics, commands: int = 1) -> tuple[str, ...]:
    """Features of a map that is fed the plant's parameters: those of a map that is not, the
    parameters, and of a family each parameter's product with what it multiplies."""
    known = polynomial(dynamics.joints, commands)
    return (*known, *dynamics.parameter_names, *dynamics.products)


def known_features(features: Sequence[str], parameters: Sequence[str]) -> None:
    """Raises BadArtifact for a factor that is neither a symbol nor one of the parameters."""
    for feature in features:
        for factor in feature.split("*"):
            if factor != "1" and not _FACTOR.fullmatch(factor) and factor not in parameters:
                raise BadArtifact(
                    f"the feature {feature!r} has an unknown factor {factor!r}",
                    hint=f"Factors are {_WORDS}, and the plant's parameters.",
                )


def design(
    features: Sequence[str], states: Array, issued: Array, parameters: Mapping[str, float | Array]
) -> Array:
    """Values of the features, `(n, features)`; a parameter is one number or one for each row."""
    joints = states.shape[1] // 2
    columns = {"q": states.T[:joints], "v": states.T[joints:], "u": issued.T}
    ones = np.ones(len(states))
    return np.stack([ones * value(feature, columns, parameters) for feature in features], axis=1)


def value(
    feature: str, columns: Mapping[str, Sequence[Any] | Array], parameters: Mapping[str, Any]
) -> Any:
    """A feature's value, of whatever numpy's functions take: `columns` are positions `q`,
    velocities `v` and commands `u`, one for each.

    Raises BadArtifact where the plant has no such joint or command.
    """
    product: Any = 1.0
    for factor in feature.split("*"):
        known = _FACTOR.fullmatch(factor)
        if known is None:
            product = product * (1.0 if factor == "1" else parameters[factor])
            continue
        function, inner, of, plain, at = known.groups()
        table, number = columns[inner or plain], int(of or at or 0)
        if number >= len(table):
            raise BadArtifact(
                f"the feature's factor {factor!r} names number {number} of {len(table)}",
                hint="Numbers count from 0.",
            )
        product = product * (_FUNCTIONS[function](table[number]) if function else table[number])
    return product
