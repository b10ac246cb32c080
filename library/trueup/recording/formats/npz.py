"""NumPy archives: `*.npz`, whose arrays are the columns of one table."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Limits
from trueup.errors import MalformedRecording, TooLarge
from trueup.recording.format import Format
from trueup.recording.in_memory import table_recording
from trueup.recording.table import TableRecording

MAGIC = b"PK\x03\x04"
MOST_ARRAYS = 4096
# what zipfile, zlib and numpy raise at a damaged archive
UNSOUND = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    OSError,
    EOFError,
    KeyError,
    SyntaxError,
    NotImplementedError,
    RuntimeError,
)


class Npz(Format):
    """Source: NEP 1, the format of NumPy's files. Pickled objects are not read."""

    name = "npz"
    suffixes = (".npz",)

    def knows(self, path: Path, head: bytes) -> bool:
        return path.is_file() and (path.suffix == ".npz" or head.startswith(MAGIC))

    def recordings(self, path: Path, limits: Limits) -> Sequence[TableRecording]:
        recording = table_recording(_arrays(path, limits), path.stem)
        recording.format = self.name
        return [recording]


def _arrays(path: Path, limits: Limits) -> dict[str, NDArray[Any]]:
    size = path.stat().st_size
    try:
        with zipfile.ZipFile(path) as archive:
            unfolded = sum(entry.file_size for entry in archive.infolist())
            if len(archive.infolist()) > MOST_ARRAYS or unfolded > max(
                limits.unfold_free_bytes, min(limits.unfold_ratio * size, limits.file_bytes)
            ):
                raise TooLarge(
                    f"{path.name} unfolds to {unfolded} bytes", limit="unfold_ratio", byte=0
                )
        with np.load(path, allow_pickle=False) as arrays:
            return {name: _array(arrays, name) for name in arrays.files}
    except UNSOUND as error:
        raise MalformedRecording(
            f"{path.name} is no sound npz: {error}", rule="container"
        ) from error


def _array(arrays: Any, name: str) -> NDArray[Any]:
    """An array, or nothing in its place where it holds objects, which are not read."""
    try:
        return np.asarray(arrays[name])
    except ValueError as error:
        if "allow_pickle" in str(error):
            return np.array("")
        raise


FORMAT = Npz()
