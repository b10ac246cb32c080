"""Noise: what a sensor adds to the quantity that it measures.

Encoders, filters and differentiated velocities make noise that is correlated from sample to sample,
and some of it has outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FORGOTTEN = 200  # samples before the first that counts


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """A model of noise with standard deviation 1.

    Equation: n(k) = correlation * n(k - 1) + sqrt(1 - correlation^2) * w(k), w independent, normal
    or Student's t with `tails` degrees of freedom, more than 2; 0 stands for normal. Source: G. E.
    P. Box, G. M. Jenkins, Time Series Analysis (1970), section 3.2.
    """

    correlation: float = 0.0
    tails: float = 0.0

    def drawn(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Noise of independent channels, `(samples, channels)`. White normal noise takes one random
        draw for each number."""
        before = FORGOTTEN if self.correlation else 0
        size = (samples + before, channels)
        fresh = (
            rng.standard_t(self.tails, size) / np.sqrt(self.tails / (self.tails - 2.0))
            if self.tails
            else rng.normal(size=size)
        )
        if not self.correlation:
            return fresh
        kept, noise = np.sqrt(1.0 - self.correlation**2), fresh
        for k in range(1, len(noise)):
            noise[k] = self.correlation * noise[k - 1] + kept * fresh[k]
        return noise[before:]


WHITE = NoiseModel()
