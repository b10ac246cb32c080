"""Actuator delay: a command acts later than it is stamped."""

from trueup.model.effect import Effect, Number, Port, Scale


class ActuatorDelay(Effect):
    """A pure transport delay between issue and action; a step that straddles a change takes the
    mean.

    Equation: u'(t) = u(t - delay)
    Source: O. J. M. Smith, Chemical Engineering Progress 53 (1957).
    Blind: commands that do not change; one loop's log cannot tell it from a delay of the sensor.
    """

    name = "actuator_delay"
    port = Port.COMMAND
    category = "timing"
    late = True
    params = (Number("delay", Scale.TIME, 0.0, 0.0, 1.0),)
    states = ("past",)
    begins = ("u",)
    memory = (Scale.COMMAND,)
    starts = tuple((0.01 * 1.7**i,) for i in range(9))

    @staticmethod
    def apply(lag_s, past, delay):  # type: ignore[no-untyped-def]
        return lag_s + delay, past
