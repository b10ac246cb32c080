"""Thermal derating: the drive grows weaker with recent use."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class ThermalDerating(Effect):
    """A gain that falls with heat, to a least one; the square of the command heats, time cools.

    Equation: u' = u max(1 - loss heat, least), time_constant heat' = (u / scale)^2 - heat, the
      scale being the command's limit
    Source: B. C. Kuo, J. Tal, DC Motors and Control Systems (1978), the one-body thermal model.
    Blind: episodes short against the time constant, or of even use.
    """

    name = "thermal_derating"
    port = Port.COMMAND
    order = 9
    category = "saturation"
    in_mjcf = "multiply actuator_gainprm by 1 - loss x heat as the heat builds up"
    of_drive = True
    params = (
        Number("loss", Scale.ONE, 0.0, 0.0, 4.0, called="gain lost per heat"),
        Number("time_constant", Scale.TIME, 10.0, 0.2, 100.0),
        Number("least", Scale.ONE, 0.05, 0.05, 1.0, called="least gain"),
    )
    states = ("heat",)
    begins = ("zero",)
    memory = (Scale.ONE,)
    optional = ("least",)
    starts = tuple((0.5, 1.0 * 1.8**i, least) for i in range(7) for least in (0.05, 0.7, 0.85))

    @staticmethod
    def apply(u, h, u_scale, heat, loss, time_constant, least):  # type: ignore[no-untyped-def]
        x = h / time_constant
        use = (u / u_scale) * (u / u_scale)
        heat = use + (heat - use) / (1.0 + x * (1.0 + 0.5 * x))
        return u * np.minimum(np.maximum(1.0 - loss * heat, least), 1.0 + loss), heat
