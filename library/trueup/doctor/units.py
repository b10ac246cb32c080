"""Units: what a number may have been logged in instead of the declared unit."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

DEGREE, TURN = pi / 180.0, 2.0 * pi
ANGLES = {"rad": 1.0, "deg": DEGREE, "turns": TURN, "mrad": 1e-3}
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
RATES = {"rad/s": 1.0, "deg/s": DEGREE, "rpm": TURN / 60.0, "turns/s": TURN}
SPEEDS = {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1.0 / 3.6}
CONFUSED = frozenset({"rad", "deg", "m", "mm", "rad/s", "deg/s", "rpm", "m/s", "mm/s"})
SPELLINGS = {
    "radian": "rad",
    "radians": "rad",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "rev": "turns",
    "revolutions": "turns",
    "metre": "m",
    "meter": "m",
    "radians/s": "rad/s",
    "degrees/s": "deg/s",
    "°/s": "deg/s",
    "rev/s": "turns/s",
}
# what a full-scale command is in the numbers of drives: percent, bytes, PWM registers of servos,
# thousandths, converters of 10 to 16 bits
COUNTS = (100.0, 127.0, 255.0, 885.0, 1000.0, 1023.0, 2047.0, 4095.0, 10000.0, 32767.0, 65535.0)


@dataclass(frozen=True, slots=True)
class OtherUnit:
    """A unit that a log may be in. A value in it times `factor` is in the declared unit; a `usual`
    one is often confused with it."""

    unit: str
    factor: float
    is_length: bool
    usual: bool


def other_units(declared: str) -> list[OtherUnit]:
    """The other units of a declared unit's dimension; none where the unit is not known."""
    unit = SPELLINGS.get(declared.strip(), declared.strip())
    for table in (ANGLES, LENGTHS, RATES, SPEEDS):
        if unit in table:
            own = table[unit]
            return [
                OtherUnit(name, size / own, table in (LENGTHS, SPEEDS), {name, unit} <= CONFUSED)
                for name, size in table.items()
                if name != unit
            ]
    return []
