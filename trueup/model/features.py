"""Declared features of a linear map: products of the plant's symbols.

A feature is written as factors with `*` between them: `1`, `q`, `v`, `u`, `q*v`, `q*q`, `sign(v)`, `abs(v)`, `k*q`. The symbols are
`q`, `v` (joint 0), the issued command `u`, and the plant's parameters by name. Nothing is evaluated: an unknown factor is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadArtifact

Array = NDArray[np.float64]

POLYNOMIAL = ("q", "v", "u", "q*v", "q*u", "v*u", "q*q", "v*v", "u*u", "1")
CONDITIONED = (*POLYNOMIAL, "k", "c", "b", "k*q", "c*v", "b*u")
FRICTION = ("1", "v", "u", "sign(v)", "abs(v)")

_FACTORS: Mapping[str, Callable[[Array, Array], Array]] = {
    "1": lambda s, u: np.ones(len(s)),
    "q": lambda s, u: s[:, 0],
    "v": lambda s, u: s[:, s.shape[1] // 2],
    "u": lambda s, u: u[:, 0],
    "sign(v)": lambda s, u: np.sign(s[:, s.shape[1] // 2]),
    "abs(v)": lambda s, u: np.abs(s[:, s.shape[1] // 2]),
    "sin(q)": lambda s, u: np.sin(s[:, 0]),
}


def known_features(features: Sequence[str], parameters: Sequence[str] = ("k", "c", "b")) -> None:
    """Raises BadArtifact for a factor that is neither a symbol nor a parameter."""
    for feature in features:
        for factor in feature.split("*"):
            if factor not in _FACTORS and factor not in parameters:
                raise BadArtifact(
                    f"the feature {feature!r} has an unknown factor {factor!r}",
                    hint=f"Factors are {', '.join(_FACTORS)} and the plant's parameters.",
                )


def design(features: Sequence[str], states: Array, issued: Array, parameters: Mapping[str, float | Array]) -> Array:
    """Values of the features, `(n, features)`; a parameter is one number or one for each row."""
    columns = []
    for feature in features:
        column = np.ones(len(states))
        for factor in feature.split("*"):
            column = column * (_FACTORS[factor](states, issued) if factor in _FACTORS else parameters[factor])
        columns.append(column)
    return np.stack(columns, axis=1)
