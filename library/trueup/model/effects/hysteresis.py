"""Hysteresis: a force that depends on the way the joint came."""

from trueup.model.effect import Effect, Number, Port, Scale


class Hysteresis(Effect):
    """A force that builds up over a distance after each reversal.

    Equation: a - level z, z' = (v - s(z) (shape |v| z + (1 - shape) v |z|)) / distance, s(z) = 1 -
      sharpness + sharpness |z|
    Source: R. Bouc (1967), Y.-K. Wen, Journal of the Engineering Mechanics Division 102 (1976),
      exponents 1 to 2 (sharpness 0 to 1); shape 1 and sharpness 0 is P. Dahl's model (1968).
    Blind: an episode without reversals; a distance far below the motion looks like Coulomb
      friction, one far above like a spring.
    """

    name = "hysteresis"
    port = Port.FORCE
    category = "structure"
    in_mjcf = (
        "integrate the hidden state beside mj_step and subtract its force from qfrc_applied of the "
        "joint; with shape 1 and sharpness 0 a dcmotor's bristles are it"
    )
    params = (
        Number("level", Scale.ACCELERATION),
        Number("distance", Scale.POSITION, 1.0, 0.02, 1.0, called="presliding distance"),
        Number("shape", Scale.ONE, 0.5, 0.0, 1.0, called="shape of the loop"),
        Number("sharpness", Scale.ONE, 0.5, 0.0, 1.0, called="sharpness of the loop"),
    )
    states = ("z",)
    begins = ("zero",)
    memory = (Scale.ONE,)
    starts = tuple((0.2, 0.03 * 2.0**i, shape, 0.5) for i in range(6) for shape in (0.5, 1.0))

    @staticmethod
    def apply(a, v, h, z, level, distance, shape, sharpness):  # type: ignore[no-untyped-def]
        stroke = h * v / distance
        soft = 1.0 - sharpness + sharpness * abs(z)
        z = (z + stroke * (1.0 - (1.0 - shape) * abs(z) * soft)) / (
            1.0 + shape * soft * abs(stroke)
        )
        return a - level * z, z
