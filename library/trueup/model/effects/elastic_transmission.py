"""Elastic transmission: motor and load are joined by a spring."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class ElasticTransmission(Effect):
    """Two masses and a damped spring; the observed joint is the load's.

    Equation: load (1 - share) a = passive + T, motor share m'' = drive - T, T = K w + D w', w = m -
      q, K = (2 pi / period)^2 share (1 - share), D = 4 pi ratio / period share (1 - share)
    Source: M. W. Spong, Journal of Dynamic Systems, Measurement, and Control 109 (1987).
    Blind: an excitation far below the resonance.
    """

    name = "elastic_transmission"
    port = Port.FORCE
    order = 9
    category = "structure"
    in_mjcf = (
        "give the motor a joint and an inertia of its own, joined to the link's by a tendon with "
        "stiffness and damping; the command does so where the joint's armature holds the motor's "
        "share, and no servo asks where the link is"
    )
    params = (
        Number("period", Scale.TIME, 0.0, 0.0, 4.0, called="period of the resonance"),
        Number("ratio", Scale.ONE, 0.05, 0.0, 1.0, called="damping ratio"),
        Number("share", Scale.ONE, 0.3, 0.02, 0.9, called="motor's share of the inertia"),
    )
    states = ("twist", "rate")
    begins = ("zero", "zero")
    memory = (Scale.POSITION, Scale.VELOCITY)
    starts = tuple((0.05 * 1.4**i, ratio, 0.3) for i in range(12) for ratio in (0.02, 0.1))

    @staticmethod
    def apply(a, passive, drive, mobility, h, implicit, twist, rate, period, ratio, share):  # type: ignore[no-untyped-def]
        alpha = 0.5 * (1.0 - implicit)  # twist and rate step as position and velocity do
        w = 6.283185307179586 / np.maximum(period, 6.0 * h)
        both = share * (1.0 - share)
        stiff, damp = both * w * w, 2.0 * both * w * ratio
        left = np.maximum(1.0 - share * mobility, 0.05)
        apart = 1.0 / share + mobility / left
        # of a step, squared; a symmetric one swings too fast
        angle = 2.0 * alpha * apart * stiff * h * h
        stiff = stiff * (1.0 - angle / 12.0 * (1.0 - angle / 30.0))
        ahead = twist + alpha * h * rate
        kick = (
            drive / share
            - mobility * passive / left
            - apart * (stiff * ahead + (1.0 - alpha) * damp * rate)
        )
        after = (rate + h * kick) / (1.0 + alpha * h * apart * damp)
        load = (passive + stiff * ahead + damp * ((1.0 - alpha) * rate + alpha * after)) / left
        soft = period > 0.0
        return (
            a + (load - (passive + drive)) * soft,
            (ahead + (1.0 - alpha) * h * after) * soft,
            after * soft,
        )
