"""A received file of any format becomes an episode of a plant that is declared already.

An MCAP file that declares its role is an episode as it is. Of everything else it is said beside its
bytes what it was recorded for, and it is transcribed. Where names do not tell which signals are
meant, the guess is sent back, to be confirmed as a mapping.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import orjson

from trueup.episode.container import LIMITS, MAGIC, Limits
from trueup.episode.layout import Layout
from trueup.episode.role import Role, role_named
from trueup.errors import BadMapping, NotAnEpisode
from trueup.recording.archive import unpacked
from trueup.recording.described import MEDIA_TYPES, Described
from trueup.recording.format import Run, open_runs
from trueup.recording.guess import guess
from trueup.recording.mapping import SignalMapping, read_mapping
from trueup.recording.transcribe import Origin, origin_of, transcribe


def as_episode(
    path: Path, layout: Layout, described: Described, to: Path, limits: Limits = LIMITS
) -> Path:
    """The file of the episode that a received file is: itself, or `to`, which is written. Raises
    BadEpisode, BadMapping, NotInstalled."""
    with path.open("rb") as file:
        is_mcap = file.read(len(MAGIC)) == MAGIC
    if described.is_silent and (is_mcap or described.media_type in (None, *MEDIA_TYPES["mcap"])):
        return path
    role = _role(described)
    origin = origin_of(path)
    with unpacked(path, limits) as opened:
        run = _part(open_runs(opened, limits, described.media_type), described.part)
        mapping = _mapping(run, layout, described)
        declared = run.recording.role
        if declared is not None and declared != role:
            raise NotAnEpisode(
                f"the recording declares the role {declared}, and {role} is asked for", rule="role"
            )
        with to.open("xb") as file:
            transcribe(
                run.recording,
                mapping,
                layout,
                file,
                role=role,
                conditions=described.conditions,
                origin=Origin(described.name or origin.file, origin.sha256, run.part),
            )
    return to


def _role(described: Described) -> Role:
    if described.role is None:
        raise NotAnEpisode(
            "nothing says what the recording is for",
            rule="role",
            hint=f"Send the query parameter role, one of {', '.join(Role)}.",
        )
    return role_named(described.role)


def _part(runs: list[Run], part: str | None) -> Run:
    """The run that is meant, by its name in the file or its number from 0. Raises NotAnEpisode."""
    if part is None and len(runs) == 1:
        return runs[0]
    names = [run.recording.name.partition("/")[2] or run.recording.name for run in runs]
    chosen = [run for i, run in enumerate(runs) if part in (names[i], run.recording.name, str(i))]
    if len(chosen) == 1:
        return replace(chosen[0], part=names[runs.index(chosen[0])])
    what = "holds several runs" if part is None else f"has no part {part!r}"
    raise NotAnEpisode(
        f"the file {what}",
        rule="part",
        hint="Name one with the query parameter part, and send the file again for each.",
        parts=names,
    )


def _mapping(run: Run, layout: Layout, described: Described) -> SignalMapping:
    if described.mapping is not None:
        return read_mapping(described.mapping)
    mapping = guess(run.recording, layout=layout)
    if any("signal" in s.guessed for s in mapping.sources) or mapping.clock_guessed:
        raise BadMapping(
            f"names alone do not decide; guessed are {'; '.join(mapping.guesses)}",
            field="mapping",
            hint="Send this mapping, or a corrected one, as the query parameter mapping.",
            mapping=orjson.dumps(mapping.document()).decode(),
        )
    return mapping
