"""Load-dependent friction: a gear rubs the more, the more force it transmits."""

from trueup.model.effect import Effect, Number, Port, Scale


class LoadDependentFriction(Effect):
    """Dry friction in proportion to the transmitted force: half the difference of drive and spring or gravity.

    Equation: |friction| <= coefficient |drive - spring| / 2
    Source: M. Duclusaud et al., Extended Friction Models for the Physics Simulation of Servo Actuators, ICRA 2025, model M3.
    Blind: an episode in which the load stays the same.
    """

    name = "load_dependent_friction"
    port = Port.FRICTION
    category = "structure"
    params = (Number("coefficient", Scale.ONE, 0.0, 0.0, 4.0),)
    starts = ((0.1,), (0.4,))

    @staticmethod
    def apply(drive, spring, coefficient):  # type: ignore[no-untyped-def]
        return 0.5 * coefficient * abs(drive - spring)
