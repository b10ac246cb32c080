"""Deadband: small commands do nothing."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class Deadband(Effect):
    """A drive that answers only beyond a threshold, and from there on by the excess.

    Equation: u' = sign(u) max(|u| - width, 0)
    Source: H. K. Khalil, Nonlinear Systems (2002), section 1.2.7.
    Blind: commands that are all small, or all large and of one sign.
    """

    name = "deadband"
    port = Port.COMMAND
    order = 5
    category = "structure"
    in_mjcf = (
        "set ctrl to sign(u) max(|u| - width, 0) before each step, u being what ctrl "
        "exceeds a servo's position by, and the position added again"
    )
    of_drive = True
    params = (Number("width", Scale.DRIVE, 0.0, 0.0, 0.8, called="half-width"),)
    starts = tuple((0.02 * 1.5**i,) for i in range(9))
    threshold = ("width",)

    @staticmethod
    def apply(u, width):  # type: ignore[no-untyped-def]
        return np.copysign(np.maximum(abs(u) - width, 0.0), u)
