"""Coulomb friction: a constant force against the motion, which also holds a joint at rest."""

from trueup.model.effect import Effect, Number, Port, Scale


class CoulombFriction(Effect):
    """Dry friction of constant level.

    Equation: |friction| <= level, equal to it and against v where v is not 0
    Source: C. A. Coulomb, Theorie des machines simples (1785).
    Blind: an episode in which the joint never moves, or moves one way at one speed.
    """

    name = "coulomb_friction"
    port = Port.FRICTION
    category = "structure"
    params = (Number("level", Scale.ACCELERATION),)
    starts = ((0.1,), (0.4,))

    @staticmethod
    def apply(level):  # type: ignore[no-untyped-def]
        return level
