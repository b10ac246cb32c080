"""Parts: which recordings are fitted and which are held out, and the episode that each becomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import BinaryIO

from trueup.episode.layout import Layout
from trueup.episode.role import Role, role_named
from trueup.errors import NotAnEpisode
from trueup.recording.mapping import Part, SignalMapping
from trueup.recording.recording import Recording
from trueup.recording.transcribe import Origin, transcribe

HELD_OUT = 0.3  # share of what was recorded


@dataclass(frozen=True, slots=True)
class RecordingPart:
    """A recording, by its `index` among those that it came with, from one log time on and before
    another [ns], that becomes an episode of a role."""

    recording: Recording
    index: int
    role: Role
    begin_ns: int | None = None
    end_ns: int | None = None

    def write(
        self,
        to: BinaryIO,
        mapping: SignalMapping,
        layout: Layout,
        conditions: Mapping[str, str],
        origin: Origin,
    ) -> None:
        """Write the part as an episode. Raises BadEpisode, BadMapping."""
        transcribe(
            self.recording,
            mapping,
            layout,
            to,
            role=self.role,
            conditions=conditions,
            origin=origin,
            begin_ns=self.begin_ns,
            end_ns=self.end_ns,
        )


def parts_of(
    recordings: Sequence[Recording], mapping: SignalMapping, roles: Sequence[str] | None = None
) -> list[RecordingPart]:
    """The parts of some recordings, in their order: of these `roles`, else of those that they
    declare, else the last ones are held out; of a single recording its end is. Raises
    NotAnEpisode."""
    if roles is None and len(recordings) == 1 and recordings[0].role is None:
        span = recordings[0].span(mapping.of(Part.OBSERVATIONS)[0].stream, mapping.clock)
        cut = span.last_ns - int(HELD_OUT * (span.last_ns - span.first_ns))
        return [
            RecordingPart(recordings[0], 0, Role.ADAPTATION, None, cut),
            RecordingPart(recordings[0], 0, Role.VALIDATION, cut, None),
        ]
    held_out = max(1, round(HELD_OUT * len(recordings)))
    usual = [
        r.role or (Role.VALIDATION if at >= len(recordings) - held_out else Role.ADAPTATION)
        for at, r in enumerate(recordings)
    ]
    if roles is not None and len(roles) != len(recordings):
        raise NotAnEpisode(
            f"{len(roles)} roles are given for {len(recordings)} recordings", rule="role"
        )
    return [
        RecordingPart(r, at, role_named(str(role)))
        for at, (r, role) in enumerate(zip(recordings, roles or usual, strict=True))
    ]
