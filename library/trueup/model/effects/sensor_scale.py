"""Sensor scale: the position sensor's gain is off."""

from trueup.model.effect import Effect, Number, Port, Scale


class SensorScale(Effect):
    """The observed position is a multiple of the true one; the velocity is not.

    Equation: y = (1 + error) q
    Source: J. R. Taylor, An Introduction to Error Analysis (1997), section 4.1.
    Blind: a log without velocity; on a linear plant a skewed clock does the same.
    """

    name = "sensor_scale"
    port = Port.OBSERVATION
    order = 1
    category = "observation"
    in_mjcf = "multiply the sensor's reading by 1 + error"
    params = (Number("error", Scale.ONE, 0.0, -0.6, 1.5, called="error of the scale"),)
    starts = ((0.05,), (-0.05,))

    @staticmethod
    def apply(q, v, error):  # type: ignore[no-untyped-def]
        return q * (1.0 + error), v
