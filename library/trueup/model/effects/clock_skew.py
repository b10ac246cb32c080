"""Clock skew: the true time between samples is not the stamped one."""

from trueup.model.effect import Effect, Number, Port, Scale


class ClockSkew(Effect):
    """The machine's clock runs faster or slower than the log's.

    Equation: h' = (1 + skew) h
    Source: D. L. Mills, RFC 5905, on frequency errors of clocks.
    Blind: a log without velocity, where other parameters of the model do the same; on a linear
      plant the scale of the position does.
    """

    name = "clock_skew"
    port = Port.TIMING
    category = "timing"
    in_mjcf = "stamp the log with the machine's clock; (1 + skew) timestep simulates it as it is"
    params = (Number("skew", Scale.ONE, 0.0, -0.6, 1.5, called="error of the period"),)
    starts = ((0.05,), (-0.05,))

    @staticmethod
    def apply(h, skew):  # type: ignore[no-untyped-def]
        return h * (1.0 + skew)
