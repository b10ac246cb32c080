"""One-step residuals of a predictor, episode by episode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.model.predictor import Predictor

Array = NDArray[np.float64]


def one_step_residuals(predictor: Predictor, states: Array, issued: Array) -> Array:
    """Norm over channels of (observed - predicted next observation) / declared scale, `(samples - 1,)`, of one episode."""
    plant = predictor.plant
    missed = plant.observe(states[1:]) - plant.observe(predictor.predict_batch(states[:-1], issued))
    return np.asarray(np.linalg.norm(missed / plant.scales, axis=1))
