"""Constant force: gravity, a preload, or an amplifier's offset."""

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class ConstantForce(Effect):
    """A force that is always there.

    Equation: a + level
    Source: Newton's second law.
    Blind: a linear spring whose position sensor may have a bias: the two move the rest position
      alike.
    """

    name = "constant_force"
    port = Port.FORCE
    category = "structure"
    in_mjcf = "add the level to qfrc_applied of the joint"
    params = (Number("level", Scale.ACCELERATION, 0.0, -INFINITY, INFINITY),)
    starts = ((0.05,), (-0.05,))

    @staticmethod
    def apply(a, level):  # type: ignore[no-untyped-def]
        return a + level
