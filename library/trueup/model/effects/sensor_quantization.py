"""Sensor quantization: the sensors' resolution shows."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class SensorQuantization(Effect):
    """Position and velocity are rounded to multiples of their steps.

    Equation: y = step round(x / step)
    Source: B. Widrow, I. Kollar, Quantization Noise (2008), chapter 1.
    Blind: a step below the noise, other than that the log's values lie on a lattice.
    """

    name = "sensor_quantization"
    port = Port.OBSERVATION
    order = 9
    category = "observation"
    in_mjcf = "round the sensor's reading to multiples of the step"
    counted = True
    params = (
        Number("step", Scale.POSITION, called="position step"),
        Number("velocity_step", Scale.VELOCITY),
    )
    starts = ((0.02, 0.0),)
    threshold = ("step", "velocity_step")

    @staticmethod
    def apply(q, v, step, velocity_step):  # type: ignore[no-untyped-def]
        width, velocity_width = np.maximum(step, 2.0**-200), np.maximum(velocity_step, 2.0**-200)
        return width * np.rint(q / width), velocity_width * np.rint(v / velocity_width)
