"""Quadratic drag: a force against the motion that grows with the square of the speed."""

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class QuadraticDrag(Effect):
    """Drag of a body in a fluid at high Reynolds number.

    Equation: a - coefficient |v| v
    Source: the drag equation (Lord Rayleigh, 1876).
    Blind: an episode in which the joint moves at one speed only.
    """

    name = "quadratic_drag"
    port = Port.FORCE
    category = "structure"
    params = (Number("coefficient", Scale.DRAG, 0.0, 0.0, INFINITY, called="drag coefficient"),)
    starts = ((0.2,),)

    @staticmethod
    def apply(a, v, coefficient):  # type: ignore[no-untyped-def]
        return a - coefficient * abs(v) * v
