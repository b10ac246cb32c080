"""Sensor delay: what is logged happened earlier than its stamp says."""

from trueup.model.effect import Effect, Number, Port, Scale


class SensorDelay(Effect):
    """A pure transport delay of all observations: on a log's own clock the same law as a delay of
    the command.

    Equation: y(t) = x(t - delay), that is x'(t) = f(x(t), u(t - delay)) for the logged x
    Source: as the actuator's delay; their equivalence follows by a shift of time, as the dynamics
      do not depend on it.
    Blind: one loop's log: only a second time stamp, or a log of the applied command, tells it from
      a delay of the actuator.
    """

    name = "sensor_delay"
    port = Port.OBSERVATION
    category = "timing"
    same_as = "actuator_delay"
    params = (Number("delay", Scale.TIME, 0.0, 0.0, 1.0),)
    states = ("past",)
    begins = ("u",)
    memory = (Scale.COMMAND,)
    starts = tuple((0.01 * 1.7**i,) for i in range(9))

    @staticmethod
    def apply(lag_s, past, delay):  # type: ignore[no-untyped-def]
        return lag_s + delay, past
