"""Quadratic gain: the drive's gain changes with the size of the command."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class QuadraticGain(Effect):
    """A static drive of second order: one part bends both signs of the command alike, as a supply
    that sags, one bends them apart.

    Equation: u' = u + (odd u |u| + even u^2) / scale, the scale being the command's limit
    Source: L. Ljung, System Identification (1999), section 5.2, the Hammerstein model.
    Blind: commands of one size.
    """

    name = "quadratic_gain"
    port = Port.COMMAND
    order = 10
    category = "saturation"
    in_mjcf = (
        "set ctrl to u + (odd u |u| + even u^2) / limit before each step, u being what "
        "ctrl exceeds a servo's position by, and the position added again"
    )
    of_drive = True
    params = (
        Number("odd", Scale.ONE, 0.0, -0.9, 2.0, called="change of gain with size"),
        Number("even", Scale.ONE, 0.0, -0.9, 0.9, called="difference of gain by sign"),
    )
    starts = ((0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1))

    @staticmethod
    def apply(u, u_scale, odd, even):  # type: ignore[no-untyped-def]
        return u + (odd * np.abs(u) + even * u) * u / u_scale
