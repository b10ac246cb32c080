"""Magnetic saturation: the more a motor is driven, the less torque a unit of current gives."""

from trueup.model.effect import Effect, Number, Port, Scale


class MagneticSaturation(Effect):
    """The iron of a motor carries no more flux: its torque constant falls with the current.

    Equation: u' = u / (1 + softness |u| / scale), the scale being the command's limit
    Source: A. E. Fitzgerald, C. Kingsley, S. Umans, Electric Machinery (2003), section 1.3.
    Blind: commands of one size.
    """

    name = "magnetic_saturation"
    port = Port.COMMAND
    category = "saturation"
    order = 11
    of_drive = True
    params = (Number("softness", Scale.ONE, 0.0, 0.0, 10.0),)
    starts = ((0.3,), (1.0,), (3.0,))

    @staticmethod
    def apply(u, u_scale, softness):
        return u / (1.0 + softness * abs(u) / u_scale)
