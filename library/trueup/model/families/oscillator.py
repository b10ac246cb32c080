"""Oscillator: a spring, a damper and a drive."""

from trueup.model.family import Family, Param


class Oscillator(Family):
    """A joint held by a linear spring, or a position servo seen from outside.

    Equation: a = -k q - c v + b u, per unit mass
    Source: Newton's second law with Hooke's spring (1678) and linear damping.
    """

    name = "oscillator"
    params = (
        Param("k", "1/s^2", called="stiffness"),
        Param("c", "1/s", called="damping"),
        Param("b", "acceleration / command", called="gain"),
    )
    products = ("k*q", "c*v", "b*u")

    @staticmethod
    def acceleration(q, v, u, k, c, b):  # type: ignore[no-untyped-def]
        return -k * q - c * v + b * u

    @staticmethod
    def regressors(q, v, u):  # type: ignore[no-untyped-def]
        return -q, -v, u
