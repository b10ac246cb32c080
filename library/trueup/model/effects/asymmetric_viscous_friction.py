"""Asymmetric viscous friction: it grows faster with speed one way than the other."""

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class AsymmetricViscousFriction(Effect):
    """Two viscous coefficients, one for each direction; their mean is the model's own.

    Equation: a - difference |v|, so that the coefficients are c + difference and c - difference
    Source: A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS (2019), for a
      worn screw.
    Blind: motion of one direction.
    """

    name = "asymmetric_viscous_friction"
    port = Port.FORCE
    category = "structure"
    in_mjcf = "subtract difference |v| from qfrc_applied of the joint"
    params = (
        Number(
            "difference",
            Scale.DAMPING,
            0.0,
            -INFINITY,
            INFINITY,
            called="damping forwards minus backwards, halved",
        ),
    )
    starts = ((0.1,), (-0.1,))

    @staticmethod
    def apply(a, v, difference):  # type: ignore[no-untyped-def]
        return a - difference * abs(v)
