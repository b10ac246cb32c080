"""Hard stop: an end of travel."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class HardStop(Effect):
    """A stiff, damped contact at the same distance to both sides of a centre.

    Equation: a - stiffness d - damping v (where pressed), with d = q beyond centre +- limit;
      damping is rebound times as large on the way back; the contact never pulls
    Source: K. H. Hunt, F. R. E. Crossley, Journal of Applied Mechanics 42 (1975), the linear case.
    Blind: travel within the limit. One not stiffer than eight times what the motion itself meets is
      a spring that differs by side, no stop.
    """

    name = "hard_stop"
    port = Port.FORCE
    category = "structure"
    in_mjcf = (
        "the tendon's spring is the stop's; add damping v to qfrc_applied against the "
        "motion while it is pressed"
    )
    params = (
        Number("limit", Scale.POSITION, 1e9, 0.2, 1.6, called="distance from the centre"),
        Number("stiffness", Scale.STIFFNESS, 1e3, 8.0, 1e6),
        Number("damping", Scale.DAMPING, 1.0, 0.0, 1e4),
        Number("centre", Scale.POSITION, 0.0, -0.6, 0.6),
        Number("rebound", Scale.ONE, 1.0, 0.0, 1.0, called="damping on the way back, as a part"),
    )
    optional = ("centre",)
    falls = True
    starts = tuple(
        (limit, stiffness, 1.0, 0.0, 0.5)
        for limit in (0.99, 0.97, 0.94, 0.9, 0.85, 0.78, 0.7, 0.6, 0.5, 0.4)
        for stiffness in (30.0, 300.0)
    )
    threshold = ("limit",)

    @staticmethod
    def apply(a, q, v, limit, stiffness, damping, centre, rebound):  # type: ignore[no-untyped-def]
        above = np.maximum(q - centre - limit, 0.0)
        below = np.maximum(centre - q - limit, 0.0)
        inward = damping * v * (rebound + (1.0 - rebound) * ((v > 0.0) == (above > 0.0)))
        return (
            a
            - np.maximum(stiffness * above + inward * (above > 0.0), 0.0)
            + np.maximum(stiffness * below - inward * (below > 0.0), 0.0)
        )
