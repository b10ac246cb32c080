"""Quantity: what a signal measures, as its name says it.

`elbow_pos_deg`, `cmd[pwm]`, `motor/current (mA)`, `reference/elbow/position`: names are read word
by word, and a unit stands in brackets or at the end. What no word tells is the joint.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from trueup.episode.layout import Field
from trueup.episode.units import (
    ANGLES,
    CURRENTS,
    DIMENSIONS,
    FORCES,
    LENGTHS,
    RATES,
    SPEEDS,
    TORQUES,
    VOLTAGES,
    spelled,
)
from trueup.recording.recording import Signal, Stream

BRACKETS = re.compile(r"[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$")
APART = re.compile(r"[^A-Za-z0-9·°µ]+")
WORD = re.compile(r"[A-Za-z]+\d*|\d+")
CAMEL = re.compile(r"(?<=[a-z]{2})(?=[A-Z])|(?<=[a-z0-9])(?=[A-Z][a-z])")
INDEXED = re.compile(
    r"(q|dq|qd|qdot|u|v|tau|pos|position|vel|velocity|torque|theta|omega|cmd|eff|effort)_?(\d+)"
)


def _among(text: str) -> frozenset[str]:
    return frozenset(text.split())


WORDS = {
    Field.POSITION: _among(
        "q qpos pos position positions angle angles theta th enc encoder displacement"
    ),
    Field.VELOCITY: _among("v dq qd qdot qvel vel velocity velocities speed omega rate dtheta dot"),
    Field.EFFORT: _among(
        "u tau torque torques trq effort efforts eff force current iq voltage volt volts pwm duty "
        "throttle load"
    ),
}
FIELD_WORDS = {word: field for field, of in WORDS.items() for word in of}
COMMANDED = _among(
    "cmd cmds command commands commanded des desired ref reference target goal setpoint sp action "
    "actions u input ctrl control output request requested issued"
)
MEASURED = _among(
    "meas measured actual act feedback fb obs observed observation state states present sensor "
    "applied estimated"
)
SILENT = _among("error err acc acceleration accel ddq qdd index frame episode task id")
PLAIN = _among("joint joints robot log data the of msg value")
TIME = _among("t time times timestamp timestamps stamp clock elapsed seconds secs")
# endings of names that are units, by the words that they are written in
ENDINGS = {
    ("rad",): "rad",
    ("rads",): "rad",
    ("radian",): "rad",
    ("radians",): "rad",
    ("deg",): "deg",
    ("degs",): "deg",
    ("degree",): "deg",
    ("degrees",): "deg",
    ("turns",): "turns",
    ("rev",): "turns",
    ("mrad",): "mrad",
    ("rad", "s"): "rad/s",
    ("rad", "per", "s"): "rad/s",
    ("rad", "sec"): "rad/s",
    ("radps",): "rad/s",
    ("deg", "s"): "deg/s",
    ("deg", "per", "s"): "deg/s",
    ("deg", "sec"): "deg/s",
    ("degps",): "deg/s",
    ("dps",): "deg/s",
    ("rpm",): "rpm",
    ("m",): "m",
    ("mm",): "mm",
    ("cm",): "cm",
    ("m", "s"): "m/s",
    ("mps",): "m/s",
    ("mm", "s"): "mm/s",
    ("nm",): "N·m",
    ("n", "m"): "N·m",
    ("mnm",): "mN·m",
    ("ncm",): "N·cm",
    ("newton",): "N",
    ("amps",): "A",
    ("amp",): "A",
    ("ma",): "mA",
    ("volt",): "V",
    ("volts",): "V",
    ("mv",): "mV",
    ("s",): "s",
    ("sec",): "s",
    ("ms",): "ms",
    ("us",): "us",
    ("ns",): "ns",
    ("pct",): "%",
    ("percent",): "%",
    ("pwm",): "pwm",
    ("counts",): "counts",
    ("ticks",): "counts",
}
LONGEST_ENDING = max(map(len, ENDINGS))


@dataclass(frozen=True, slots=True)
class Quantity:
    """What a signal measures: of which joint, in which field and unit, None where its name says
    nothing; whether it is a command; whether it is a time."""

    signal: Signal
    stream: str
    joint: str | None
    field: Field | None
    unit: str | None
    is_command: bool
    is_measured: bool
    is_time: bool


def quantity_of(stream: Stream, signal: Signal) -> Quantity:
    """What a signal measures, as its name and its stream's say it."""
    name, unit = _without_unit(signal.name)
    own, context = words(name), words(stream.name)
    field = signal.field or _field(own, unit) or _field(context, unit)
    marks = {*own, *context}
    return Quantity(
        signal,
        stream.name,
        signal.joint or _joint(own),
        None if marks & SILENT else field,
        unit,
        bool(marks & COMMANDED),
        bool(marks & MEASURED),
        bool(TIME & set(own)) and field is None,
    )


def _without_unit(name: str) -> tuple[str, str | None]:
    """A name without the unit at its end, and that unit."""
    bracketed = BRACKETS.search(name)
    if bracketed and bracketed[1]:
        inner = bracketed[1]
        if _is_unit(inner):
            return name[: bracketed.start()], spelled(inner)
    of_name = words(name)
    for count in range(min(LONGEST_ENDING, len(of_name) - 1), 1, -1):
        unit = ENDINGS.get(tuple(of_name[-count:]))
        if unit is not None:
            return "_".join(of_name[:-count]), unit
    *before, last = APART.split(name)
    if not before:
        return name, None
    unit = spelled(last) if _is_unit(last) else ENDINGS.get((last.lower(),))
    if unit is None:
        return name, None
    names_field = unit == "pwm"  # the quantity as well as its unit
    return "_".join([*before, last] if names_field else before), unit


def _is_unit(text: str) -> bool:
    known = any(spelled(text) in dimension for dimension in DIMENSIONS)
    if len(text) == 1:  # a small letter is a symbol, as in `joint_v`, but for these
        known = known and (text.isupper() or text in "sm°")
    return known or text.lower() in ("%", "pwm", "counts", "ticks")


def words(name: str) -> list[str]:
    """The words of a name in lower case; an index at a word's end is a word of its own."""
    parts = []
    for word in WORD.findall(CAMEL.sub("_", name)):
        indexed = INDEXED.fullmatch(word.lower())
        parts += [indexed[1], indexed[2]] if indexed else [word.lower()]
    return parts


def _field(of: list[str], unit: str | None) -> Field | None:
    """The field that a name's words tell; where they tell two, the one that is not a command's."""
    fields = [FIELD_WORDS[w] for w in of if w in FIELD_WORDS and w != "u"]
    if len(fields) > 1 and "current" in of:  # as in `current_position`
        fields = [FIELD_WORDS[w] for w in of if w in FIELD_WORDS and w not in ("u", "current")]
    if fields:
        return fields[-1] if Field.POSITION not in fields else Field.POSITION
    if unit is not None:
        for field, dimensions in (
            (Field.POSITION, (ANGLES, LENGTHS)),
            (Field.VELOCITY, (RATES, SPEEDS)),
            (Field.EFFORT, (TORQUES, FORCES, CURRENTS, VOLTAGES)),
        ):
            if any(unit in d for d in dimensions):
                return field
        if unit in ("%", "pwm"):
            return Field.EFFORT
    return Field.EFFORT if "u" in of else None


def _joint(of: list[str]) -> str | None:
    """The words of a name that say nothing else."""
    known = {*FIELD_WORDS, *COMMANDED, *MEASURED, *SILENT, *TIME}
    rest = [w for w in of if w not in known]
    if rest and all(w in PLAIN for w in rest):
        return None
    if rest and all(w.isdigit() or w in PLAIN for w in rest):
        return "joint" + "_".join(w for w in rest if w.isdigit())
    return "_".join(w for w in rest if w not in PLAIN or len(rest) > 1) or None
