"""Mapping: which signal of a recording is which channel, as a file that can be kept and used again.

    {"schema": "trueup.mapping/1",
     "time": {"signal": "time_ms", "unit": "ms"},
     "observations": [{"field": "position", "signal": "pos [deg]", "unit": "deg"}],
     "commands": [{"field": "effort", "signal": "cmd_nm", "unit": "N·m"}]}

An entry may name a `joint`, a `stream` (a topic, where there are several), and a `factor` that its
values are multiplied by, such as -1. A table's time may be `{"rate_hz": 100}` instead; messages
carry their own. `applied` are what a drive reports to have applied of the commands, `efforts` what
was measured at the commanded joints; both may be left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import orjson

from trueup.canonical import Json
from trueup.episode.layout import Channel, Field, Layout
from trueup.episode.units import TIMES, coherent, conversion, spelled
from trueup.errors import BadMapping
from trueup.recording.recording import TABLE, Clock, Recording, Wanted

SCHEMA = "trueup.mapping/1"
MAPPING_FILE = "mapping.json"  # of a case folder
MOST_LISTED = 40  # signals in a message


class Part(StrEnum):
    """What of an episode a channel belongs to."""

    OBSERVATIONS = "observations"
    COMMANDS = "commands"
    APPLIED = "applied"
    EFFORTS = "efforts"


@dataclass(frozen=True, slots=True)
class Source:
    """The signal that a channel comes from: `joint` and `field` say which channel. A value times
    `factor` is in `unit`, `` where it has none that is known. `guessed` says what of it nobody
    declared."""

    part: Part
    field: Field
    signal: str
    stream: str = TABLE
    joint: str | None = None
    unit: str = ""
    factor: float = 1.0
    guessed: tuple[str, ...] = ()

    def document(self) -> dict[str, Json]:
        """The source as JSON, without what is as it is by default."""
        return {
            **({"joint": self.joint} if self.joint else {}),
            "field": str(self.field),
            **({"stream": self.stream} if self.stream else {}),
            "signal": self.signal,
            **({"unit": self.unit} if self.unit else {}),
            **({"factor": self.factor} if self.factor != 1.0 else {}),
            **({"guessed": list(self.guessed)} if self.guessed else {}),
        }

    def belongs_to(self, channel: Channel) -> bool:
        """Whether this is the source of a channel of the same part."""
        same_joint = channel.joint is None or self.joint in (None, channel.joint)
        return same_joint and self.field is channel.field

    def factor_to(self, channel: Channel) -> float:
        """What a value is multiplied by to be in a channel's unit. Raises BadMapping."""
        if not self.unit or not channel.unit:
            return self.factor
        factor = conversion(self.unit, channel.unit)
        if factor is None:
            raise BadMapping(
                f"{self.signal!r} is in {self.unit}, and {channel.name} is declared in "
                f"{channel.unit}",
                field=f"{self.part}.{channel.name}.unit",
                hint="Correct the unit in the mapping, or declare the other in plant.json.",
            )
        return factor * self.factor


@dataclass(frozen=True, slots=True)
class SignalMapping:
    """Which signals are which channels, and how a table's rows get their time."""

    sources: tuple[Source, ...]
    clock: Clock | None = None
    clock_guessed: bool = False

    def of(self, part: Part) -> tuple[Source, ...]:
        """The sources of one part of an episode."""
        return tuple(s for s in self.sources if s.part is part)

    @property
    def wanted(self) -> Wanted:
        """Of each stream the signals that are read."""
        wanted: dict[str, list[str]] = {}
        for source in self.sources:
            signals = wanted.setdefault(source.stream, [])
            if source.signal not in signals:
                signals.append(source.signal)
        return wanted

    @property
    def guesses(self) -> tuple[str, ...]:
        """In words what nobody declared."""
        words = [
            f"the {what} of {source.signal} ({source.unit or 'no unit'})"
            if what == "unit"
            else f"that {source.signal} is the {_role(source)}"
            for source in self.sources
            for what in source.guessed
        ]
        if self.clock_guessed and self.clock is not None and self.clock.signal is not None:
            words.append(f"that {self.clock.signal} is the time, in {self.clock.unit}")
        return tuple(words)

    def confirmed(self) -> SignalMapping:
        """The mapping once a person has agreed to it."""
        return replace(
            self,
            sources=tuple(replace(s, guessed=()) for s in self.sources),
            clock_guessed=False,
        )

    def document(self) -> dict[str, Json]:
        """The mapping as JSON."""
        document: dict[str, Json] = {"schema": SCHEMA}
        if self.clock is not None:
            document["time"] = (
                {"rate_hz": self.clock.rate_hz}
                if self.clock.rate_hz is not None
                else {
                    "signal": self.clock.signal,
                    "unit": self.clock.unit,
                    **({"guessed": True} if self.clock_guessed else {}),
                }
            )
        for part in Part:
            if of := self.of(part):
                document[str(part)] = [s.document() for s in of]
        return document

    def require(self, recording: Recording) -> None:
        """Raises BadMapping where a recording lacks a signal."""
        for source in self.sources:
            stream = recording.stream(source.stream)
            if stream is None or stream.signal(source.signal) is None:
                listed = [stream] if stream is not None else recording.streams
                there = [s.name for one in listed for s in one.signals]
                raise BadMapping(
                    f"{recording.name} has no signal {source.signal!r}"
                    + (f" on {source.stream}" if source.stream else ""),
                    field=str(source.part),
                    hint=f"It has {', '.join(there[:MOST_LISTED]) or 'none'}.",
                )


def _role(source: Source) -> str:
    what = {
        Part.OBSERVATIONS: f"{source.field}",
        Part.COMMANDS: "command",
        Part.APPLIED: "applied command",
        Part.EFFORTS: "measured effort",
    }[source.part]
    return what + (f" of {source.joint}" if source.joint else "")


def read_mapping(text: bytes | str) -> SignalMapping:
    """The mapping that a file holds. Raises BadMapping."""
    try:
        document = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise BadMapping(f"the mapping is not JSON: {error}", field="") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise BadMapping(f"a mapping declares the schema {SCHEMA}", field="schema")
    _no_more(document, "", "schema", "time", *Part)
    sources = tuple(
        _source(entry, part, f"{part}[{i}]")
        for part in Part
        for i, entry in enumerate(_entries(document, part))
    )
    for part in (Part.OBSERVATIONS, Part.COMMANDS):
        if not any(s.part is part for s in sources):
            raise BadMapping(f"the mapping names no {part}", field=str(part))
    time = document.get("time")
    is_guessed = isinstance(time, dict) and time.get("guessed") is True
    return SignalMapping(sources, _clock(time), is_guessed)


def guesses_of(source: Mapping[str, str]) -> tuple[str, ...]:
    """In words what was guessed of the signals of an episode with this `source`, and confirmed by
    nobody."""
    text = source.get("mapping")
    return read_mapping(text).guesses if text else ()


def _entries(document: Mapping[str, Any], part: Part) -> list[Any]:
    entries = document.get(part, [])
    if not isinstance(entries, list):
        raise BadMapping(f"{part} is a list of channels", field=str(part))
    return entries


def _source(entry: Any, part: Part, field: str) -> Source:
    if not isinstance(entry, dict):
        raise BadMapping("a channel is an object with a field and a signal", field=field)
    _no_more(entry, field, "joint", "field", "stream", "signal", "unit", "factor", "guessed")
    for key in ("field", "signal"):
        if not isinstance(entry.get(key), str):
            raise BadMapping(f"a channel needs a {key}", field=f"{field}.{key}")
    if entry["field"] not in set(Field):
        raise BadMapping(f"a field is one of {', '.join(Field)}", field=f"{field}.field")
    for key in ("joint", "stream", "unit"):
        if not isinstance(entry.get(key, ""), str):
            raise BadMapping(f"{key} is text", field=f"{field}.{key}")
    factor = entry.get("factor", 1.0)
    if isinstance(factor, bool) or not isinstance(factor, int | float) or factor == 0.0:
        raise BadMapping("factor is a number other than 0", field=f"{field}.factor")
    guessed = entry.get("guessed", [])
    if not isinstance(guessed, list) or not all(isinstance(g, str) for g in guessed):
        raise BadMapping("guessed is a list of words", field=f"{field}.guessed")
    return Source(
        part,
        Field(entry["field"]),
        entry["signal"],
        entry.get("stream", TABLE),
        entry.get("joint") or None,
        spelled(entry.get("unit", "")),
        float(factor),
        tuple(guessed),
    )


def _clock(time: Any) -> Clock | None:
    if time is None:
        return None
    if not isinstance(time, dict) or ("signal" in time) == ("rate_hz" in time):
        raise BadMapping("time is a signal with its unit, or a rate_hz", field="time")
    _no_more(time, "time", "signal", "unit", "rate_hz", "guessed")
    if "rate_hz" in time:
        rate = time["rate_hz"]
        if isinstance(rate, bool) or not isinstance(rate, int | float) or not rate > 0.0:
            raise BadMapping("rate_hz is a number above 0", field="time.rate_hz")
        return Clock(rate_hz=float(rate))
    unit = spelled(str(time.get("unit", "s")))
    if unit not in TIMES:
        raise BadMapping(f"time is in {', '.join(TIMES)}", field="time.unit")
    return Clock(str(time["signal"]), unit)


def _no_more(document: Mapping[str, Any], field: str, *allowed: str) -> None:
    for key in document:
        if key not in allowed:
            raise BadMapping(
                f"{key!r} is no field of a mapping",
                field=f"{field}.{key}".lstrip("."),
                hint=f"There are {', '.join(allowed)}.",
            )


def layout_of(mapping: SignalMapping, names: Mapping[str, str]) -> Layout:
    """The layout of episodes that a mapping makes, in coherent units, for a plant that nobody has
    declared yet. `names` are topics by `observation` and `command`."""
    observations = tuple(
        Channel(_channel_name(s, mapping), coherent(s.unit), s.field, s.joint)
        for s in mapping.of(Part.OBSERVATIONS)
    )
    commands = tuple(
        Channel(_channel_name(s, mapping), coherent(s.unit), s.field, s.joint)
        for s in mapping.of(Part.COMMANDS)
    )
    return Layout(observations, commands, **{f"{k}_topic": v for k, v in names.items()})


SYMBOLS = {Field.POSITION: "q", Field.VELOCITY: "v", Field.EFFORT: "u"}


def _channel_name(source: Source, mapping: SignalMapping) -> str:
    """`q`, `v`, `u`, with the joint's name where there are several."""
    symbol = "u" if source.part is Part.COMMANDS else SYMBOLS[source.field]
    several = len({s.joint for s in mapping.sources}) > 1
    return f"{symbol}_{source.joint}" if several and source.joint else symbol


def matched(
    mapping: SignalMapping, layout: Layout
) -> Iterator[tuple[Part, Channel, Source | None]]:
    """Every channel of a layout with its source, None where the mapping names none."""
    parts: Sequence[tuple[Part, tuple[Channel, ...]]] = (
        (Part.OBSERVATIONS, layout.observations),
        (Part.COMMANDS, layout.commands),
        (Part.APPLIED, layout.commands),
        (Part.EFFORTS, layout.efforts),
    )
    for part, channels in parts:
        for channel in channels:
            source = next((s for s in mapping.of(part) if s.belongs_to(channel)), None)
            yield part, channel, source
