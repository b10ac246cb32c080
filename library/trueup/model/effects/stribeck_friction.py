"""Stribeck friction: dry friction that is larger near rest than in motion."""

from trueup.model.effect import Effect, Number, Port, Scale


class StribeckFriction(Effect):
    """Dry friction that falls from its breakaway level to a lower one as the joint gains speed.

    Equation: |friction| <= level + extra / (1 + x^2 + sharpness (x^4 / 2! + ... + x^12 / 6!)), x =
      v / speed
    Source: R. Stribeck, Zeitschrift des VDI 46 (1902); the algebraic curve: B. Armstrong-Helouvry,
      P. Dupont, C. Canudas de Wit, Automatica 30 (1994), section 2; with sharpness 1 it is the
      Gaussian one but for its last thousandth.
    Blind: an episode without slow motion, or without fast one.
    """

    name = "stribeck_friction"
    port = Port.FRICTION
    category = "structure"
    in_mjcf = (
        "frictionloss holds the level; what comes on top near rest is written as bristles, "
        "which give way a little before they slide, with a Gaussian curve. For the curve itself "
        "add it to dof_frictionloss before each step instead"
    )
    params = (
        Number("level", Scale.ACCELERATION, called="Coulomb level"),
        Number("extra", Scale.ACCELERATION, called="added level near rest"),
        Number("speed", Scale.VELOCITY, 1.0, 0.005, 1.0, called="Stribeck speed"),
        Number("sharpness", Scale.ONE, 0.0, 0.0, 1.0, called="sharpness of the fall"),
    )
    optional = ("sharpness",)
    contains = "coulomb_friction"
    starts = tuple((level, 0.2, 0.02 * 2.0**i, 0.5) for i in range(5) for level in (0.05, 0.2))

    @staticmethod
    def apply(v, level, extra, speed, sharpness):  # type: ignore[no-untyped-def]
        x = (v / speed) * (v / speed)
        return level + extra / (
            1.0
            + x
            * (1.0 + sharpness * x * (1 / 2 + x * (1 / 6 + x * (1 / 24 + x * (1 / 120 + x / 720)))))
        )
