"""Gain asymmetry: the drive is stronger one way than the other."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class GainAsymmetry(Effect):
    """Two gains, one for each sign of the command; their mean is the model's own.

    Equation: u' = u + asymmetry |u|
    Source: A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS (2019), for an
      axis that differs by direction.
    Blind: commands of one sign.
    """

    name = "gain_asymmetry"
    port = Port.COMMAND
    order = 8
    category = "structure"
    in_mjcf = (
        "set ctrl to u + asymmetry |u| before each step, u being what ctrl exceeds a "
        "servo's position by, and the position added again"
    )
    of_drive = True
    params = (Number("asymmetry", Scale.ONE, 0.0, -0.95, 0.95),)
    starts = ((0.1,), (-0.1,))

    @staticmethod
    def apply(u, asymmetry):  # type: ignore[no-untyped-def]
        return u + asymmetry * np.abs(u)
