"""Sensor drift: the position sensor's zero wanders."""

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class SensorDrift(Effect):
    """A bias that grows with the time since the episode began.

    Equation: y = q + rate t
    Source: IEEE Std 1293, annex on bias trends.
    Blind: a plant without a force that depends on the position; short episodes.
    """

    name = "sensor_drift"
    port = Port.OBSERVATION
    order = 3
    category = "observation"
    in_mjcf = "add rate x time to the sensor's reading"
    params = (Number("rate", Scale.DRIFT, 0.0, -INFINITY, INFINITY, called="drift rate"),)
    starts = ((0.02,), (-0.02,))

    @staticmethod
    def apply(q, v, t, rate):  # type: ignore[no-untyped-def]
        return q + rate * t, v
