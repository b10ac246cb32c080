"""HDF5: datasets as the columns of one table; of a file of demonstrations, a table for each."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Limits
from trueup.errors import MalformedRecording, NotAnEpisode, TooLarge
from trueup.recording.format import Format, optional
from trueup.recording.table import KINDS, TableRecording

MAGIC = b"\x89HDF\r\n\x1a\n"
BLOCK_ROWS, MOST_DATASETS, MOST_ENTRIES = 65536, 4096, 256
RUN = re.compile(r"(demo|episode|trajectory|traj|run|ep)[_-]?(\d+)$", re.IGNORECASE)
UNIT_ATTRIBUTES = ("unit", "units")


class Hdf5(Format):
    """Datasets whose first axis is time. Groups that are numbered, as `demo_0`, are runs of their
    own; without any, the whole file is one."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5", ".he5")

    def knows(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGIC) or (path.is_file() and path.suffix in self.suffixes)

    def recordings(self, path: Path, limits: Limits) -> Sequence[TableRecording]:
        runs: dict[str, dict[str, _Column]] = {}
        with _opened(path) as file:
            for name, dataset in _datasets(file, path):
                run, column = _split(name)
                runs.setdefault(run, {}).update(_columns(column, name, dataset))
        if not any(runs.values()):
            raise NotAnEpisode(f"{path.name} holds no numbers", rule="columns")
        return [
            TableRecording(
                f"{path.stem}/{run}" if run else path.stem,
                self.name,
                tuple(kept),
                _blocks_of(path, kept, limits),
            )
            for run, columns in sorted(runs.items(), key=lambda r: _order(r[0]))
            if (kept := _of_one_length(columns))
        ]


# of a column its dataset, which entry of a row it is, and its rows
_Column = tuple[str, int | None, int]


def _opened(path: Path) -> Any:
    h5py = optional("h5py", "tables", "HDF5")
    try:
        return h5py.File(path, "r", locking=False)
    except OSError as error:
        raise _malformed(path, error) from error


def _malformed(path: Path, error: Exception) -> MalformedRecording:
    return MalformedRecording(f"{path.name} is no sound HDF5: {error}", rule="container")


def _datasets(file: Any, path: Path) -> list[tuple[str, Any]]:
    """Every dataset of numbers that lies in the file itself, by its path; links to other files are
    not followed."""
    h5py, datasets = optional("h5py", "tables", "HDF5"), list[tuple[str, Any]]()
    waiting = [("", file)]
    try:
        while waiting:
            prefix, group = waiting.pop()
            for key in group:
                if isinstance(group.get(key, getlink=True), h5py.ExternalLink):
                    continue
                item, name = group[key], f"{prefix}{key}"
                if isinstance(item, h5py.Group):
                    if name.count("/") < MOST_ENTRIES:
                        waiting.append((f"{name}/", item))
                elif isinstance(item, h5py.Dataset) and not item.is_virtual and not item.external:
                    datasets.append((name, item))
                if len(datasets) + len(waiting) > MOST_DATASETS:
                    raise TooLarge(
                        f"{path.name} has more than {MOST_DATASETS} datasets",
                        limit="datasets",
                        byte=0,
                    )
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise _malformed(path, error) from error
    return sorted(datasets, key=lambda d: d[0])


def _split(name: str) -> tuple[str, str]:
    """The run that a dataset belongs to, `` where its file is one, and its name in it."""
    parts = name.split("/")
    for at, part in enumerate(parts[:-1]):
        if RUN.fullmatch(part):
            return part, "/".join(parts[at + 1 :])
    return "", name


def _order(run: str) -> tuple[int, str]:
    numbered = RUN.fullmatch(run)
    return (int(numbered[2]) if numbered else -1, run)


def _columns(column: str, name: str, dataset: Any) -> dict[str, _Column]:
    if dataset.dtype.kind not in KINDS or dataset.ndim not in (1, 2) or dataset.shape[0] < 2:  # noqa: PLR2004  (rows, and numbers of a row)
        return {}
    unit = next((str(dataset.attrs[a]) for a in UNIT_ATTRIBUTES if a in dataset.attrs), "")
    suffix = f" [{unit}]" if unit else ""
    rows = int(dataset.shape[0])
    if dataset.ndim == 1:
        return {column + suffix: (name, None, rows)}
    width = int(dataset.shape[1])
    if width > MOST_ENTRIES:
        return {}
    return {f"{column}[{i}]{suffix}": (name, i, rows) for i in range(width)}


def _of_one_length(columns: Mapping[str, _Column]) -> dict[str, _Column]:
    """The columns of the length that most have: what a file says once is no signal."""
    if not columns:
        return {}
    length = Counter(rows for _, _, rows in columns.values()).most_common(1)[0][0]
    return {name: c for name, c in columns.items() if c[2] == length}


def _blocks_of(path: Path, columns: Mapping[str, _Column], limits: Limits) -> Any:
    def blocks(names: Sequence[str]) -> Iterator[Mapping[str, NDArray[Any]]]:
        rows = next(iter(columns.values()))[2]
        with _opened(path) as file:
            for name in dict.fromkeys(columns[n][0] for n in names):
                _allow(file[name], path, limits)
            for begin in range(0, rows, BLOCK_ROWS):
                part = slice(begin, min(rows, begin + BLOCK_ROWS))
                try:
                    read = {
                        name: np.asarray(file[name][part])
                        for name in dict.fromkeys(columns[n][0] for n in names)
                    }
                except (OSError, ValueError, RuntimeError) as error:
                    raise _malformed(path, error) from error
                yield {
                    n: read[name] if entry is None else read[name][:, entry]
                    for n in names
                    for name, entry, _ in [columns[n]]
                }

    return blocks


def _allow(dataset: Any, path: Path, limits: Limits) -> None:
    """Raises TooLarge where a dataset declares more than its bytes in the file may unfold to."""
    declared = int(dataset.size) * int(dataset.dtype.itemsize)
    chunk = np.prod(dataset.chunks) * dataset.dtype.itemsize if dataset.chunks else 0
    if chunk > limits.chunk_bytes or declared > max(
        limits.unfold_free_bytes, limits.unfold_ratio * path.stat().st_size
    ):
        raise TooLarge(
            f"the dataset {dataset.name} of {path.name} unfolds to {declared} bytes",
            limit="unfold_ratio",
            byte=0,
        )


FORMAT = Hdf5()
