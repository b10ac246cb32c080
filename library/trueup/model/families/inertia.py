"""Inertia: a mass, a damper and a drive."""

from trueup.model.family import Family, Param


class Inertia(Family):
    """A joint that nothing holds: a linear axis, a wheel.

    Equation: a = -c v + b u, per unit mass
    Source: Newton's second law with linear damping.
    """

    name = "inertia"
    params = (
        Param("c", "1/s", called="damping"),
        Param("b", "acceleration / command", called="gain"),
    )
    products = ("c*v", "b*u")

    @staticmethod
    def acceleration(q, v, u, c, b):  # type: ignore[no-untyped-def]
        return -c * v + b * u

    @staticmethod
    def regressors(q, v, u):  # type: ignore[no-untyped-def]
        return -v, u
