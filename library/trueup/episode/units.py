"""Units: their sizes, how they are spelled, and what a number may have been logged in instead of
the declared unit."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

DEGREE, TURN = pi / 180.0, 2.0 * pi
STANDARD_GRAVITY = 9.80665  # [m/s^2]
ANGLES = {"rad": 1.0, "deg": DEGREE, "turns": TURN, "mrad": 1e-3}
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
RATES = {"rad/s": 1.0, "deg/s": DEGREE, "rpm": TURN / 60.0, "turns/s": TURN}
SPEEDS = {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1.0 / 3.6}
TORQUES = {"N·m": 1.0, "mN·m": 1e-3, "N·cm": 1e-2, "kgf·cm": STANDARD_GRAVITY * 1e-2}
FORCES = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
CURRENTS = {"A": 1.0, "mA": 1e-3}
VOLTAGES = {"V": 1.0, "mV": 1e-3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
MECHANICAL = (ANGLES, LENGTHS, RATES, SPEEDS)
DIMENSIONS = (*MECHANICAL, TORQUES, FORCES, CURRENTS, VOLTAGES, TIMES)
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
    "dps": "deg/s",
    "mps": "m/s",
    "nm": "N·m",
    "n.m": "N·m",
    "n*m": "N·m",
    "n m": "N·m",
    "newtonmeter": "N·m",
    "mnm": "mN·m",
    "ncm": "N·cm",
    "kgcm": "kgf·cm",
    "kgf.cm": "kgf·cm",
    "n": "N",
    "amp": "A",
    "amps": "A",
    "ampere": "A",
    "a": "A",
    "ma": "mA",
    "volt": "V",
    "volts": "V",
    "mv": "mV",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "millis": "ms",
    "milliseconds": "ms",
    "usec": "us",
    "µs": "us",
    "micros": "us",
    "microseconds": "us",
    "nsec": "ns",
    "nanos": "ns",
    "nanoseconds": "ns",
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


def spelled(unit: str) -> str:
    """A unit as it is spelled here; one that is not known stays as it is."""
    plain = unit.strip()
    if any(plain in dimension for dimension in DIMENSIONS):
        return plain
    return SPELLINGS.get(plain, SPELLINGS.get(plain.lower(), plain))


def conversion(unit: str, to: str) -> float | None:
    """A value in `unit` times this is in the unit `to`; None where the two measure different
    things, or one is not known and they are spelled differently."""
    unit, to = spelled(unit), spelled(to)
    if unit == to:
        return 1.0
    for dimension in DIMENSIONS:
        if unit in dimension and to in dimension:
            return dimension[unit] / dimension[to]
    return None


def coherent(unit: str) -> str:
    """The unit of the same dimension whose size is 1: rad of deg, m/s of km/h. A unit that is not
    known stays as it is."""
    own = spelled(unit)
    for dimension in DIMENSIONS:
        if own in dimension:
            return next(iter(dimension))
    return own


def other_units(declared: str) -> list[OtherUnit]:
    """The other units of a declared unit's dimension; none where the unit is not known."""
    unit = spelled(declared)
    for table in MECHANICAL:
        if unit in table:
            own = table[unit]
            return [
                OtherUnit(name, size / own, table in (LENGTHS, SPEEDS), {name, unit} <= CONFUSED)
                for name, size in table.items()
                if name != unit
            ]
    return []
