"""Pendulum: gravity, a damper and a drive."""

import numpy as np

from trueup.model.family import Family, Param


class Pendulum(Family):
    """A rigid link under gravity, hanging down at q = 0 [rad].

    Equation: a = -k sin q - c v + b u, per unit inertia
    Source: Huygens, Horologium Oscillatorium (1673), with linear damping.
    """

    name = "pendulum"
    params = (
        Param("k", "1/s^2", called="gravity"),
        Param("c", "1/s", called="damping"),
        Param("b", "acceleration / command", called="gain"),
    )
    products = ("k*sin(q)", "c*v", "b*u")

    @staticmethod
    def acceleration(q, v, u, k, c, b):  # type: ignore[no-untyped-def]
        return -k * np.sin(q) - c * v + b * u

    @staticmethod
    def regressors(q, v, u):  # type: ignore[no-untyped-def]
        return -np.sin(q), -v, u
