"""Cogging: a force that repeats with the position."""

import numpy as np

from trueup.model.effect import INFINITY, Effect, Number, Port, Scale


class Cogging(Effect):
    """Attraction of magnets to slots, or of a gear's teeth.

    Equation: a + sine sin(2 pi q / pitch) + cosine cos(2 pi q / pitch)
    Source: D. C. Hanselman, Brushless Permanent Magnet Motor Design (1994), section 4.
    Blind: motion shorter than a pitch.
    """

    name = "cogging"
    port = Port.FORCE
    category = "structure"
    in_mjcf = (
        "add sine sin(2 pi q / pitch) + cosine cos(2 pi q / pitch) to qfrc_applied of the joint"
    )
    periodic = True
    params = (
        Number(
            "sine", Scale.ACCELERATION, 0.0, -INFINITY, INFINITY, called="amplitude of the sine"
        ),
        Number(
            "cosine", Scale.ACCELERATION, 0.0, -INFINITY, INFINITY, called="amplitude of the cosine"
        ),
        Number("pitch", Scale.POSITION, 1.0, 0.02, 1.0),
    )
    starts = tuple(
        s for i in range(30) for s in ((0.02, 0.0, 0.05 * 1.1**i), (0.0, 0.02, 0.05 * 1.1**i))
    )

    @staticmethod
    def apply(a, q, sine, cosine, pitch):  # type: ignore[no-untyped-def]
        turns = q / pitch
        turns = turns - np.rint(turns)
        # sin and cos of 2 pi turns by polynomials of the double angle: no library call in
        # the step
        half = turns * turns
        x = 3.141592653589793 * turns
        square = 9.869604401089358 * half
        s = x * (
            1.0
            - square
            * (
                1 / 6
                - square
                * (1 / 120 - square * (1 / 5040 - square * (1 / 362880 - square / 39916800)))
            )
        )
        c = 1.0 - square * (
            1 / 2
            - square
            * (
                1 / 24
                - square
                * (1 / 720 - square * (1 / 40320 - square * (1 / 3628800 - square / 479001600)))
            )
        )
        return a + sine * (2.0 * s * c) + cosine * (c * c - s * s)
