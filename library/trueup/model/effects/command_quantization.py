"""Command quantization: the drive knows only so many levels."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class CommandQuantization(Effect):
    """The command is rounded to a multiple of a step.

    Equation: u' = step round(u / step)
    Source: B. Widrow, I. Kollar, Quantization Noise (2008), chapter 1.
    Blind: commands that lie on the same grid already.
    """

    name = "command_quantization"
    port = Port.COMMAND
    order = 1
    category = "structure"
    in_mjcf = "round ctrl to multiples of the step before each step"
    params = (Number("step", Scale.COMMAND, 0.0, 0.0, 1.0),)
    starts = tuple((0.97**i,) for i in range(110))
    grid_refined = "step"
    threshold = ("step",)

    @staticmethod
    def apply(u, step):  # type: ignore[no-untyped-def]
        # a power of two so small that dividing by it, rounding and multiplying give u
        # again
        width = np.maximum(step, 2.0**-200)
        return width * np.rint(u / width)
