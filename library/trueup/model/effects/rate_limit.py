"""Rate limit: the drive's output cannot change faster than so much."""

import numpy as np

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class RateLimit(Effect):
    """A slew rate.

    Equation: |y'| <= rate, y follows u
    Source: D. W. Clarke et al., Guidance, Control, and Dynamics: the usual actuator model of flight
      control.
    Blind: commands that change more slowly.
    """

    name = "rate_limit"
    port = Port.COMMAND
    order = 4
    category = "saturation"
    in_mjcf = (
        "let ctrl change by no more than rate x timestep from step to step; a dcmotor's controller "
        "does so where neither a lag nor a constant force acts beside it"
    )
    params = (Number("rate", Scale.RATE, INFINITY, 0.02, 1e3, called="largest rate"),)
    states = ("y",)
    begins = ("u",)
    memory = (Scale.COMMAND,)
    falls = True
    starts = tuple((0.1 * 1.5**i,) for i in range(16))
    threshold = ("rate",)

    @staticmethod
    def apply(u, h, implicit, y, rate):  # type: ignore[no-untyped-def]
        after = y + np.minimum(np.maximum(u - y, -rate * h), rate * h)
        moving = np.minimum(abs(u - y) / (rate * h), 1.0)  # the part of the step in which it moves
        return after - 0.5 * (1.0 - implicit) * (after - y) * moving, after
