"""Apache Parquet, a group of rows at a time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from trueup.episode.container import Limits
from trueup.recording.format import Format
from trueup.recording.parquet_table import ParquetTable
from trueup.recording.table import TableRecording

MAGIC = b"PAR1"


class Parquet(Format):
    """Source: Apache Parquet format 2.11."""

    name = "parquet"
    suffixes = (".parquet",)

    def knows(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGIC) or (path.is_file() and path.suffix == ".parquet")

    def recordings(self, path: Path, limits: Limits) -> Sequence[TableRecording]:
        table = ParquetTable([path], limits)
        return [TableRecording(path.stem, self.name, table.columns, table.blocks)]


FORMAT = Parquet()
