"""Folders that come as one file: a zip archive of a bag or of a dataset.

An archive is unpacked only after its list of entries was looked at: names that lie within the
folder, ordinary files, and no more bytes than a recording may unfold to.
"""

from __future__ import annotations

import stat
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from trueup.episode.container import Limits
from trueup.errors import MalformedRecording, TooLarge

MAGIC = b"PK\x03\x04"
MOST_ENTRIES, COPIED_BYTES = 10_000, 1 << 20
SKIPPED = ("videos/", "images/")  # of a dataset: what no joint's motion is read from


@contextmanager
def unpacked(path: Path, limits: Limits) -> Iterator[Path]:
    """A folder with what a zip archive holds, while it is used; the file itself where it is none.
    Raises MalformedRecording, TooLarge."""
    if not _is_archive(path):
        yield path
        return
    with TemporaryDirectory(dir=path.parent) as folder:
        try:
            with zipfile.ZipFile(path) as archive:
                _unpack(archive, Path(folder), path.stat().st_size, limits)
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError) as error:
            raise MalformedRecording(
                f"{path.name} is no sound zip archive: {error}", rule="container"
            ) from error
        inside = list(Path(folder).iterdir())
        yield inside[0] if len(inside) == 1 and inside[0].is_dir() else Path(folder)


def _is_archive(path: Path) -> bool:
    """Whether a file is a zip archive of other files than NumPy's arrays."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return False
    try:
        with zipfile.ZipFile(path) as archive:
            return any(not e.filename.endswith(".npy") for e in archive.infolist()[:MOST_ENTRIES])
    except zipfile.BadZipFile:
        return False


def _unpack(archive: zipfile.ZipFile, folder: Path, size: int, limits: Limits) -> None:
    entries = archive.infolist()
    if len(entries) > MOST_ENTRIES:
        raise TooLarge(f"more than {MOST_ENTRIES} files", limit="entries", byte=0)
    left = int(min(limits.file_bytes, max(limits.unfold_free_bytes, limits.unfold_ratio * size)))
    for entry in entries:
        name = PurePosixPath(entry.filename)
        is_ordinary = stat.S_IFMT(entry.external_attr >> 16) in (0, stat.S_IFREG, stat.S_IFDIR)
        if name.is_absolute() or ".." in name.parts or "\\" in entry.filename or not is_ordinary:
            raise MalformedRecording(
                f"the archive holds {entry.filename!r}, which is no file within it",
                rule="container",
            )
        if entry.is_dir() or any(part in f"{entry.filename}" for part in SKIPPED):
            continue
        to = folder / name
        to.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as source, to.open("xb") as copy:
            while data := source.read(COPIED_BYTES):
                left -= len(data)
                if left < 0:
                    raise TooLarge(
                        "the archive unfolds to more than is allowed", limit="unfold_ratio", byte=0
                    )
                copy.write(data)
