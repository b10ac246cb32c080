"""Sensor bias: the position sensor's zero is off."""

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class SensorBias(Effect):
    """A constant added to the observed position.

    Equation: y = q + bias
    Source: J. R. Taylor, An Introduction to Error Analysis (1997), section 4.1.
    Blind: a plant without a force that depends on the position; on a linear spring a constant force
      does the same.
    """

    name = "sensor_bias"
    port = Port.OBSERVATION
    order = 2
    category = "observation"
    in_mjcf = "add the bias to the sensor's reading"
    params = (Number("bias", Scale.POSITION, 0.0, -INFINITY, INFINITY),)
    starts = ((0.05,), (-0.05,))

    @staticmethod
    def apply(q, v, bias):  # type: ignore[no-untyped-def]
        return q + bias, v
