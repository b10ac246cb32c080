"""Dropped frames: some samples repeat the one before."""

from trueup.model.effect import Effect, Number, Port, Scale


class DroppedFrames(Effect):
    """A lost frame shows the last one again; on the mean the log is late by the time that frames
    are held.

    Equation: y(t_i) = x(t_j), j the last frame that arrived; mean delay = period fraction / (1 -
      fraction)
    Source: L. Schenato, IEEE Transactions on Automatic Control 53 (2008), the hold strategy.
    Blind: a joint at rest, for there every frame repeats the last.
    """

    name = "dropped_frames"
    port = Port.OBSERVATION
    order = 0
    category = "timing"
    in_mjcf = "hold the sensor's last value in what reads it"
    counted = True
    params = (Number("fraction", Scale.ONE, 0.0, 0.0, 0.9, called="fraction of frames"),)
    starts = ((0.1,),)

    @staticmethod
    def apply(lag_s, period, fraction):  # type: ignore[no-untyped-def]
        return lag_s + period * fraction / (1.0 - fraction)
