"""ROS 2 bags in SQLite: `*.db3` files, and folders that `ros2 bag record` leaves.

A file is read as a database only after what it declares was looked at: an ordinary table `topics`
and an ordinary table `messages`, no view and no trigger that would run somebody else's SQL.
Source: rosbag2_storage_sqlite3, schema versions 1 to 4 (2026).
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from trueup.episode.container import Limits, Schema, Topic
from trueup.errors import MalformedRecording, NotAnEpisode, TooLarge
from trueup.recording.format import Format, require_size
from trueup.recording.messages import Block, MessageRecording, gathered

MAGIC = b"SQLite format 3\0"
COLUMNS = {"topics": {"id", "name", "type"}, "messages": {"topic_id", "timestamp", "data"}}
METADATA_FILE = "metadata.yaml"


class RosBag2(Format):
    """A SQLite bag, or the folder of one."""

    name = "rosbag2"
    suffixes = (".db3",)

    def knows(self, path: Path, head: bytes) -> bool:
        if path.is_dir():
            return (path / METADATA_FILE).is_file() and any(path.glob("*.db3*"))
        return head.startswith(MAGIC) or path.suffix == ".db3"

    def recordings(self, path: Path, limits: Limits) -> Sequence[MessageRecording]:
        files = sorted(path.glob("*.db3"), key=_number) if path.is_dir() else [path]
        if not files:
            raise NotAnEpisode(
                f"{path.name} is a compressed bag",
                rule="format",
                hint="Decompress it with `ros2 bag convert`, or record with `-s mcap`.",
            )

        def blocks() -> Iterator[Block]:
            for at, file in enumerate(files):  # the parts of one run
                yield from _blocks(file, limits, at)

        return [MessageRecording(path.stem, self.name, blocks)]


def _number(path: Path) -> tuple[int, str]:
    digits = path.stem.rpartition("_")[2]
    return int(digits) if digits.isdigit() else 0, path.name


def _blocks(file: Path, limits: Limits, part: int) -> Iterator[Block]:
    require_size(file, limits)
    with _opened(file) as bag:
        by_number = _topics(bag, part * limits.channels, limits)
        topics = {t.id: t for t in by_number.values()}
        yield from gathered(topics, _messages(bag, by_number, file, limits))


def _messages(
    bag: sqlite3.Connection, topics: Mapping[int, Topic], file: Path, limits: Limits
) -> Iterator[tuple[int, int, bytes]]:
    """Every message with its topic's id and its time [ns]; `topics` by their number in the bag.
    Raises MalformedRecording, TooLarge."""
    rows = bag.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id")
    for index, (number, timestamp, data) in enumerate(rows):
        topic = topics.get(number) if isinstance(number, int) else None
        if topic is None or not isinstance(timestamp, int) or not isinstance(data, bytes):
            raise MalformedRecording(
                f"message {index} of {file.name} names no topic, time or bytes",
                rule="known",
                index=index,
            )
        if len(data) > limits.record_bytes or index >= limits.records:
            raise TooLarge(
                f"message {index} has {len(data)} bytes; {limits.records} messages of "
                f"{limits.record_bytes} bytes are allowed",
                limit="record_bytes" if index < limits.records else "records",
                byte=0,
            )
        yield topic.id, timestamp, data


@contextmanager
def _opened(file: Path) -> Iterator[sqlite3.Connection]:
    """A database that nothing is written to and whose own SQL is not run. Raises
    MalformedRecording."""
    try:
        uri = f"{file.resolve().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as bag:
            bag.execute("PRAGMA trusted_schema = OFF")
            bag.execute("PRAGMA cell_size_check = ON")
            bag.execute("PRAGMA query_only = ON")
            bag.execute("PRAGMA mmap_size = 0")
            _require_tables(bag, file)
            yield bag
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise MalformedRecording(
            f"{file.name} cannot be read as a bag: {error}", rule="container"
        ) from error


def _require_tables(bag: sqlite3.Connection, file: Path) -> None:
    declared = bag.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    kinds = {name: (kind, sql or "") for kind, name, sql in declared}
    if any(kind in ("view", "trigger") for kind, _, _ in declared):
        raise MalformedRecording(
            f"{file.name} declares views or triggers, which no bag has", rule="container"
        )
    for table, columns in COLUMNS.items():
        kind, sql = kinds.get(table, ("", ""))
        if kind != "table" or str(sql).upper().lstrip().startswith("CREATE VIRTUAL"):
            raise MalformedRecording(
                f"{file.name} is a database without a table `{table}`, and no bag",
                rule="container",
            )
        there = {row[1] for row in bag.execute(f"PRAGMA table_xinfo({table})") if row[6] == 0}
        if not columns <= there:
            raise MalformedRecording(
                f"the table `{table}` of {file.name} lacks {', '.join(sorted(columns - there))}",
                rule="container",
            )


def _topics(bag: sqlite3.Connection, first: int, limits: Limits) -> dict[int, Topic]:
    """The topics by their number in the bag."""
    tables = {row[0] for row in bag.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    definitions: dict[str, tuple[str, bytes]] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        for kind, encoding, text in bag.execute(query):
            definitions[str(kind)] = (str(encoding), str(text or "").encode())
    columns = {row[1] for row in bag.execute("PRAGMA table_xinfo(topics)")}
    format_ = "serialization_format" if "serialization_format" in columns else "'cdr'"
    topics = {}
    for at, (number, name, kind, encoding) in enumerate(
        bag.execute(f"SELECT id, name, type, {format_} FROM topics")
    ):
        if at >= limits.channels:
            raise TooLarge(f"more than {limits.channels} topics", limit="channels", byte=0)
        how, text = definitions.get(str(kind), ("ros2msg", b""))
        schema = Schema(at + 1, str(kind), how, text[: limits.definition_bytes])
        topics[int(number)] = Topic(first + at, schema, str(name), str(encoding), {})
    return topics


FORMAT = RosBag2()
