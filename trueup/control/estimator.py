"""Bring a delayed observation forward through the commands issued since."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.model.predictor import Predictor

Array = NDArray[np.float64]


def bring_forward(predictor: Predictor, seen: Array, issued: Array) -> Array:
    """The state now `(states,)`, from the one seen `(states,)` and the commands `(delay, commands)` issued since."""
    state = seen[None, :]
    for command in issued:
        state = predictor.predict_batch(state, command[None, :])
    return np.asarray(state[0])
