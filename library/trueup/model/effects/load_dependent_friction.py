"""Load-dependent friction: a gear rubs the more, the more force it transmits."""

from trueup.model.effect import NULL, Effect, Number, Port, Scale


class LoadDependentFriction(Effect):
    """Dry friction in proportion to the transmitted force, half the difference of the drive and
    what it works against: a spring, gravity, in a robot also what the joints' motion throws. More
    of it near rest.

    Equation: |friction| <= (coefficient + extra / (1 + (v / speed)^2)) |drive - spring| / 2
    Source: M. Duclusaud et al., Extended Friction Models for the Physics Simulation of Servo
      Actuators, ICRA 2025, models M3 and M5.
    Blind: an episode in which the load stays the same.
    """

    name = "load_dependent_friction"
    port = Port.FRICTION
    category = "structure"
    in_mjcf = "set dof_frictionloss from the transmitted force before each step"
    params = (
        Number("coefficient", Scale.ONE, 0.0, 0.0, 4.0, called="friction coefficient"),
        Number("extra", Scale.ONE, 0.0, 0.0, 4.0, called="added coefficient near rest"),
        Number("speed", Scale.VELOCITY, 1.0, 0.005, 1.0, called="Stribeck speed"),
    )
    optional = ("extra", "speed")
    tries = ((0.1, 0.05), (0.1, 0.2))
    starts = ((0.1, NULL, NULL), (0.4, NULL, NULL))

    @staticmethod
    def apply(drive, spring, v, coefficient, extra, speed):  # type: ignore[no-untyped-def]
        return 0.5 * abs(drive - spring) * (coefficient + extra / (1.0 + (v / speed) * (v / speed)))
