"""Asked: what a person says of a recording, in place of what its names would tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trueup.episode.units import ANGLES, LENGTHS, RATES, SPEEDS, spelled
from trueup.errors import BadMapping
from trueup.recording.recording import Clock

# of each channel the units that it may be in, any of a command
ALLOWED: Mapping[str, tuple[str, ...]] = {
    "q": (*ANGLES, *LENGTHS),
    "v": (*RATES, *SPEEDS),
    "u": (),
}


@dataclass(frozen=True)
class Asked:
    """What a person says of a recording: `signals` and `units` by `q`, `v`, `u` (of one joint), the
    joint, the topics, the time of a table, and what joints the entries of a list are of that has no
    names."""

    signals: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    joint: str | None = None
    observation: str | None = None
    command: str | None = None
    clock: Clock | None = None
    names: tuple[str, ...] = ()
    controllers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


NOTHING_ASKED = Asked()


def check(asked: Asked) -> None:
    """Raises BadMapping for a channel or a unit that there is none of."""
    for symbol in (*asked.signals, *asked.units):
        if symbol not in ALLOWED:
            raise BadMapping(
                f"there is no channel {symbol!r}",
                field=symbol,
                hint="They are q, the position, v, the velocity, and u, the command.",
            )
    for symbol, unit in asked.units.items():
        known = ALLOWED[symbol]
        if known and spelled(unit) not in known:
            raise BadMapping(
                f"{unit!r} is no unit of {symbol}", field=symbol, hint=f"Give {', '.join(known)}."
            )
