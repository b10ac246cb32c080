"""What is said of a recording beside its bytes, and what files of each format are called. Nothing
here loads a reader: a server hands recordings to another process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

# of each format by its name what an upload may call it
MEDIA_TYPES: Mapping[str, tuple[str, ...]] = {
    "mcap": ("application/mcap", "application/x-mcap"),
    "rosbag2": ("application/vnd.sqlite3", "application/x-sqlite3"),
    "rosbag1": ("application/x-rosbag",),
    "csv": ("text/csv", "text/tab-separated-values"),
    "parquet": ("application/vnd.apache.parquet", "application/x-parquet"),
    "hdf5": ("application/x-hdf5", "application/x-hdf"),
    "npz": ("application/x-npz",),
    "lerobot": (),
}
ARCHIVE_TYPES = ("application/zip",)  # of a folder


@dataclass(frozen=True, slots=True)
class Described:
    """The file's name and media type, the role and conditions of the episode, the mapping as JSON,
    and the part that is meant of a file of several runs."""

    name: str | None = None
    media_type: str | None = None
    role: str | None = None
    conditions: Mapping[str, str] = field(default_factory=dict)
    mapping: str | None = None
    part: str | None = None

    @property
    def is_silent(self) -> bool:
        """Whether nothing is said: the file speaks for itself."""
        return not (self.role or self.conditions or self.mapping or self.part)
