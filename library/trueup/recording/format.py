"""Format: one adapter, and how the one for a file is found."""

from __future__ import annotations

import importlib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

from trueup.episode.container import LIMITS, Limits
from trueup.errors import NotAnEpisode, NotInstalled, TooLarge, of_file
from trueup.recording import formats
from trueup.recording.described import MEDIA_TYPES
from trueup.recording.recording import Recording

HEAD_BYTES = 64  # of a file, by which a format knows its own


class Format(ABC):
    """One format of recordings.

    `name` stands in provenance; `suffixes` are the ends of its files' names.
    """

    name: str
    suffixes: tuple[str, ...]

    @abstractmethod
    def knows(self, path: Path, head: bytes) -> bool:
        """Whether a file that begins so, or a folder, is of this format."""

    @abstractmethod
    def recordings(self, path: Path, limits: Limits) -> Sequence[Recording]:
        """Every run that a file or a folder of this format holds. Raises BadEpisode,
        NotInstalled."""


@cache
def known_formats() -> tuple[Format, ...]:
    """Every format, those that a file's first bytes tell before those that only its name tells."""
    modules = [
        importlib.import_module(f"{formats.__name__}.{m.name}")
        for m in pkgutil.iter_modules(formats.__path__)
    ]
    return tuple(sorted((m.FORMAT for m in modules), key=lambda f: (f.name == "csv", f.name)))


def format_of(path: Path, media_type: str | None = None) -> Format:
    """The format of a file or a folder, which a media type may name. Raises NotAnEpisode."""
    if not path.exists():
        raise NotAnEpisode(f"there is no {path}", rule="format", hint="Name a file or a folder.")
    head = b""
    if path.is_file():
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    named = [f for f in known_formats() if media_type in MEDIA_TYPES[f.name]]
    for format_ in named or known_formats():
        if format_.knows(path, head):
            return format_
    what = f"{path.name} is no {named[0].name}" if named else f"{path.name} is of no known format"
    names = ", ".join(f"{f.name} ({' '.join(f.suffixes)})" for f in known_formats())
    raise NotAnEpisode(what, rule="format", hint=f"Known are {names}.")


@dataclass(frozen=True, slots=True)
class Run:
    """A recording, the file or folder that it was opened from, and which part of that it is, ``
    where it is all of it."""

    recording: Recording
    path: Path
    part: str


def open_runs(path: Path, limits: Limits = LIMITS, media_type: str | None = None) -> list[Run]:
    """Every run that a file or a folder of any format holds. A folder that is of no format holds
    those of its files. Raises BadEpisode, NotInstalled."""
    if path.is_dir() and not _is_recording(path):
        runs = [run for file in _readable(path) for run in open_runs(file, limits)]
        if not runs:
            raise NotAnEpisode(
                f"{path} holds no recording of a known format",
                rule="format",
                hint="A case is a folder with plant.json and *.mcap; docs/recordings.md lists the "
                "formats of recordings.",
            )
        return runs
    with of_file(path.name):
        if path.is_file():
            require_size(path, limits)
        recordings = format_of(path, media_type).recordings(path, limits)
    several = len(recordings) > 1
    return [Run(r, path, r.name if several else "") for r in recordings]


def holds_recordings(folder: Path) -> bool:
    """Whether a folder is a recording, or holds files whose names say that they are."""
    return _is_recording(folder) or bool(_readable(folder))


def _is_recording(folder: Path) -> bool:
    return any(f.knows(folder, b"") for f in known_formats())


def _readable(folder: Path) -> list[Path]:
    suffixes = tuple(s for f in known_formats() for s in f.suffixes)
    return sorted(p for p in folder.iterdir() if p.is_file() and p.name.endswith(suffixes))


def require_size(path: Path, limits: Limits) -> None:
    """Raises TooLarge where a file has more bytes than are allowed."""
    size = path.stat().st_size
    if size > limits.file_bytes:
        raise TooLarge(
            f"{path.name} has {size} bytes, {limits.file_bytes} are allowed",
            limit="file_bytes",
            byte=0,
        )


def optional(module: str, extra: str, what: str) -> ModuleType:
    """A module that an adapter needs. Raises NotInstalled, which names the extra that brings it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.split(".", maxsplit=1)[0]
        raise NotInstalled(
            f"reading {what} needs {package}, which is not installed",
            hint=f"Install it with `pip install 'trueup[{extra}]'`.",
        ) from error
