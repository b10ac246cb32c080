"""Which signals of a recording are which channels: shown to a person, and asked for once."""

from __future__ import annotations

import sys

from trueup.errors import BadMapping
from trueup.recording.mapping import MAPPING_FILE, Part, SignalMapping
from trueup_cli.show import ask, table


def confirmed(mapping: SignalMapping, *, is_agreed: bool = False) -> SignalMapping:
    """Shows a mapping, and asks whether what was guessed is so, if there is a person to ask.

    Raises BadMapping if it is not.
    """
    show_mapping(mapping)
    if not mapping.guesses or is_agreed or not sys.stdin.isatty():
        return mapping
    if ask(f"Guessed: {'; '.join(mapping.guesses)}. Is that so?"):
        return mapping.confirmed()
    raise BadMapping(
        "the guess was not taken",
        field="signals",
        hint="Name them to `trueup init` with --signal.q, --signal.v, --signal.u, --unit.q … and "
        f"--time, or correct a {MAPPING_FILE} and hand it in with --mapping.",
    )


def show_mapping(mapping: SignalMapping) -> None:
    """Prints which signals are which channels."""
    rows = [
        (
            f"{str(s.part).removesuffix('s')} {s.joint or ''}".strip(),
            str(s.field),
            f"{s.signal} on {s.stream}" if s.stream else s.signal,
            s.unit or "as it is",
            f"guessed: {', '.join(s.guessed)}" if s.guessed else "",
        )
        for s in mapping.sources
        if s.part is not Part.EFFORTS
    ]
    clock = mapping.clock
    if clock is not None:
        what = clock.signal or f"{clock.rate_hz:g} Hz"
        guessed = "guessed" if mapping.clock_guessed else ""
        rows.append(("time", "", what, clock.unit if clock.signal else "", guessed))
    table("Signals", ["what", "field", "signal", "unit", ""], rows)
