"""Actuator lag: the drive follows its command with a time constant."""

from trueup.model.effect import Effect, Number, Port, Scale


class ActuatorLag(Effect):
    """A first-order drive; a step uses the mean of what it gives, or its end where the scheme is
    the declared implicit one.

    Equation: time_constant y' = u - y, with exp(-x) taken as 1 / (1 + x + x^2 / 2 + x^3 / 6 + x^4 /
      24)
    Source: G. F. Franklin, J. D. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems,
      section 3.3.
    Blind: commands that change slowly.
    """

    name = "actuator_lag"
    port = Port.COMMAND
    order = 7
    category = "timing"
    params = (Number("time_constant", Scale.TIME, 0.0, 0.0, 3.0),)
    states = ("y",)
    begins = ("u",)
    memory = (Scale.COMMAND,)
    starts = tuple((0.02 * 2.0**i,) for i in range(7))

    @staticmethod
    def apply(u, h, implicit, y, time_constant):  # type: ignore[no-untyped-def]
        x = h / time_constant
        kept = 1.0 / (1.0 + x * (1.0 + x * (0.5 + x * (1 / 6 + x / 24))))
        left = (y - u) * kept
        mean = u + (y - u - left) / x
        return mean + implicit * (u + left - mean), u + left
