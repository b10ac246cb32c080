"""Saturation: the drive ends below the declared limit."""

import numpy as np

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class Saturation(Effect):
    """Commands beyond a limit give what the limit gives.

    Equation: u' = clip(u, -limit, limit)
    Source: H. K. Khalil, Nonlinear Systems (2002), section 1.2.7.
    Blind: commands within the limit.
    """

    name = "saturation"
    port = Port.COMMAND
    order = 3
    category = "saturation"
    of_drive = True
    params = (Number("limit", Scale.DRIVE, INFINITY, 0.05, 1.0),)
    falls = True
    starts = tuple((0.97 - 0.09 * i,) for i in range(10))
    threshold = ("limit",)

    @staticmethod
    def apply(u, limit):  # type: ignore[no-untyped-def]
        return np.minimum(np.maximum(u, -limit), limit)
