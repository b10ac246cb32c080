"""Velocity lag: the logged velocity follows the joint's late."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale

INSTANT = 1e-9  # s


class VelocityLag(Effect):
    """First-order lag of the observed velocity alone, as of a filtered one, or of a difference of
    positions over twice the time constant.

    Equation: y' = (v - y) / time_constant, exactly for a velocity that runs straight from sample to
      sample
    Source: K. J. Astrom, B. Wittenmark, Computer-Controlled Systems (1997), section 8.2; of
      differences: P. R. Belanger et al., International Journal of Robotics Research 17 (1998).
    Blind: a log without velocity; motion that is slow beside the time constant.
    """

    name = "velocity_lag"
    port = Port.OBSERVATION
    order = 4
    category = "observation"
    late = True
    in_mjcf = "filter the velocity sensor's reading"
    params = (Number("time_constant", Scale.TIME, 0.0, 0.0, 1.0),)
    states = ("behind", "before")
    begins = ("zero", "first")
    memory = (Scale.VELOCITY, Scale.VELOCITY)
    starts = tuple((0.01 * 1.8**i,) for i in range(8))
    hides_velocity = True
    least_periods = 1.0

    @staticmethod
    def apply(q, v, since, behind, before, time_constant):  # type: ignore[no-untyped-def]
        kept = np.exp(-since / np.maximum(time_constant, INSTANT))
        behind = behind * kept - (v - before) / np.maximum(since, INSTANT) * time_constant * (
            1.0 - kept
        )
        return q, v + behind, behind, v
