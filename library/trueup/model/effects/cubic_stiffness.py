"""Cubic stiffness: a spring that hardens or softens with its deflection."""

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class CubicStiffness(Effect):
    """The next odd term of a spring's law.

    Equation: a - coefficient q^3
    Source: G. Duffing, Erzwungene Schwingungen bei veraenderlicher Eigenfrequenz (1918).
    Blind: an episode of small deflections.
    """

    name = "cubic_stiffness"
    port = Port.FORCE
    category = "structure"
    in_mjcf = "subtract coefficient q^3 from qfrc_applied of the joint"
    params = (
        Number("coefficient", Scale.CUBIC, 0.0, -INFINITY, INFINITY, called="cubic coefficient"),
    )
    starts = ((0.05,), (-0.05,))

    @staticmethod
    def apply(a, q, coefficient):  # type: ignore[no-untyped-def]
        return a - coefficient * q * q * q
