"""Read the messages of one topic, of any type and encoding, as rows of signals.

A recorder writes one structure thousands of times. Of CDR messages the first of a structure is
read, and all others that are equal but for their numbers become rows of a matrix; what differs is a
structure of its own. JSON and protobuf are read message by message.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from trueup.episode import joint_state
from trueup.episode.cdr import ROS2_NAMES, message_places
from trueup.episode.container import Message, MessageBlock, Topic
from trueup.episode.joint_state import Columns, as_columns
from trueup.errors import NotAnEpisode
from trueup.recording.cdr_tree import CdrMessage, Spot, read_message
from trueup.recording.message_tree import Numbers, rows_of
from trueup.recording.recording import Signal
from trueup.recording.ros_types import JOINT_STATE, Types, defined, known, normalised

UNREADABLE = (*joint_state.UNREADABLE, RecursionError)
NS_PER_S = 1_000_000_000
MOST_STRUCTURES = 32  # of one block of messages that are read as matrices


class TopicReader(ABC):
    """Reads the messages of a topic."""

    def __init__(self, topic: Topic) -> None:
        self.topic = topic

    @abstractmethod
    def rows(self, data: bytes) -> list[Numbers]:
        """The rows of one message. Raises what is in UNREADABLE."""

    @abstractmethod
    def columns(
        self, block: MessageBlock, messages: Sequence[Message], wanted: Sequence[str]
    ) -> Columns:
        """The wanted signals of some messages. Raises NotAnEpisode."""

    def signals(self, data: bytes) -> dict[str, Signal]:
        """The signals of one message by name."""
        return {
            name: signal for row in self.rows(data) for name, (signal, _) in row.signals.items()
        }


def topic_reader(topic: Topic) -> TopicReader | None:
    """The reader for a topic, None where its messages hold no numbers that can be read. Raises
    NotAnEpisode, NotInstalled."""
    if topic.encoding == "json":
        return _EachMessage(topic, _json)
    if topic.encoding == "protobuf" and topic.schema is not None:
        from trueup.episode.protobuf import message_class  # noqa: PLC0415  (protobuf loads slowly, few logs need it)
        from trueup.recording.protobuf_tree import tree_of  # noqa: PLC0415

        kind = message_class(topic.schema)
        return _EachMessage(topic, lambda data: tree_of(kind.FromString(data)))
    if topic.encoding in ("cdr", "ros1"):
        return _CdrMessages(topic)
    return None


def _json(data: bytes) -> Mapping[str, Any]:
    message = orjson.loads(data)
    if not isinstance(message, dict):
        raise ValueError("it is no object")
    return message


class _EachMessage(TopicReader):
    """Reads messages one by one, each by a function that makes a tree of it."""

    def __init__(self, topic: Topic, tree: Callable[[bytes], Mapping[str, Any]]) -> None:
        super().__init__(topic)
        self._tree = tree

    def rows(self, data: bytes) -> list[Numbers]:
        return rows_of(self._tree(data))

    def columns(
        self, block: MessageBlock, messages: Sequence[Message], wanted: Sequence[str]
    ) -> Columns:
        log, stamps, values = [], [], []
        for start, length, log_ns in messages:
            try:
                rows = self.rows(block.data[start : start + length])
                for row in rows:
                    later = _ns(row.later)
                    stamp = _ns(row.stamp)
                    log.append(log_ns + later)
                    stamps.append(stamp + later if stamp else 0)
                    values.append([_value(row, name) for name in wanted])
            except UNREADABLE as error:
                raise unreadable(self.topic, block, log_ns, error) from error
        return as_columns(block, log, stamps, values, len(wanted))


def _ns(parts: tuple[Any, Any] | None) -> int:
    return 0 if parts is None else int(parts[0]) * NS_PER_S + int(parts[1])


def _value(row: Numbers, name: str) -> float:
    held = row.signals.get(name)
    return float("nan") if held is None else float(held[1])


def unreadable(
    topic: Topic, block: MessageBlock, log_ns: int, error: BaseException
) -> NotAnEpisode:
    """The refusal of a message that is not what its topic says."""
    return NotAnEpisode(
        f"a message on {topic.name} cannot be read: {error}",
        rule="message",
        topic=topic.name,
        byte=block.byte,
        log_time_ns=str(log_ns),
    )


@dataclass(frozen=True, slots=True)
class _Structure:
    """What equal messages share: their bytes without their numbers, and where those stand."""

    fixed: NDArray[np.bool_]
    bytes_: NDArray[np.uint8]
    rows: list[Numbers]


class _CdrMessages(TopicReader):
    """Reads CDR messages, and those of ROS 1, by the definition of their type."""

    def __init__(self, topic: Topic) -> None:
        super().__init__(topic)
        name = topic.schema.name if topic.schema else ROS2_NAMES[0]
        self._name = normalised(name)
        self._forms = _forms(topic, self._name)
        self._structures: dict[int, list[_Structure]] = {}

    def rows(self, data: bytes) -> list[Numbers]:
        return rows_of(self._read(data).fields)

    def _read(self, data: bytes) -> CdrMessage:
        refused: ValueError | None = None
        for i, types in enumerate(self._forms):
            try:
                message = read_message(
                    types, self._name, data, is_ros1=self.topic.encoding == "ros1"
                )
            except ValueError as error:
                refused = error
                continue
            if i:  # the forms of a type that changed over the years: a log holds one of them
                self._forms = (types,)
            return message
        raise refused or ValueError(f"the type {self._name} is not known")

    def columns(
        self, block: MessageBlock, messages: Sequence[Message], wanted: Sequence[str]
    ) -> Columns:
        starts, lengths, log = message_places(block, messages)
        data = np.frombuffer(block.data, np.uint8)
        parts: list[tuple[NDArray[np.int64], Columns]] = []
        for length in np.unique(lengths):
            left, structures = np.flatnonzero(lengths == length), 0
            while len(left):
                # where many structures differ, each message is one of its own
                looked_at = left if structures < MOST_STRUCTURES else left[:1]
                rows = data[starts[looked_at][:, None] + np.arange(length)]
                structure, alike = self._structure(block, rows, int(log[left[0]]))
                for numbers in structure.rows:
                    columns = _decoded(rows[alike], log[looked_at[alike]], numbers, wanted)
                    parts.append((looked_at[alike], columns))
                left = np.concatenate([looked_at[~alike], left[len(looked_at) :]])
                structures += 1
        return _in_order(parts, len(wanted))

    def _structure(
        self, block: MessageBlock, rows: NDArray[np.uint8], log_ns: int
    ) -> tuple[_Structure, NDArray[np.bool_]]:
        """A structure that the first of some messages of one length has, and which others have
        it."""
        seen = self._structures.setdefault(rows.shape[1], [])
        for structure in seen:
            if (rows[0, structure.fixed] == structure.bytes_).all():
                break
        else:
            try:
                structure = _structure_of(rows[0], self._read(rows[0].tobytes()))
            except UNREADABLE as error:
                raise unreadable(self.topic, block, log_ns, error) from error
            if len(seen) < MOST_STRUCTURES:
                seen.append(structure)
        return structure, (rows[:, structure.fixed] == structure.bytes_).all(axis=1)


def _forms(topic: Topic, name: str) -> tuple[Types, ...]:
    """The forms that messages of a topic may have. JointState is known without its definition."""
    if topic.schema is None or (name == ROS2_NAMES[0] and topic.encoding == "cdr"):
        return (JOINT_STATE,)
    text = topic.schema.data.decode(errors="replace")
    if text.strip():
        return (defined(topic.schema.name, topic.schema.encoding, text),)
    forms = known(name)
    if not forms:
        raise NotAnEpisode(
            f"the log does not define {name}, the type of {topic.name}",
            rule="encoding",
            topic=topic.name,
            hint="Record with ROS 2 Iron or newer, or convert the bag with `ros2 bag convert`.",
        )
    return forms


def _structure_of(first: NDArray[np.uint8], message: CdrMessage) -> _Structure:
    fixed = np.ones(len(first), bool)
    for at, length in message.numbers:
        fixed[at : at + length] = False
    return _Structure(fixed, first[fixed].copy(), rows_of(message.fields))


def _decoded(
    rows: NDArray[np.uint8], log: NDArray[np.int64], numbers: Numbers, wanted: Sequence[str]
) -> Columns:
    values = np.full((len(rows), len(wanted)), np.nan)
    for column, name in enumerate(wanted):
        held = numbers.signals.get(name)
        if held is not None:
            values[:, column] = _at(rows, held[1])
    later = _times(rows, numbers.later)
    stamps = _times(rows, numbers.stamp)
    return Columns(log + later, np.where(stamps == 0, 0, stamps + later), values)


def _times(rows: NDArray[np.uint8], parts: tuple[Any, Any] | None) -> NDArray[np.int64]:
    total = np.zeros(len(rows), np.int64)
    if parts is not None:
        for part, factor in zip(parts, (NS_PER_S, 1), strict=True):
            if isinstance(part, Spot):
                total += _at(rows, part).astype(np.int64) * factor
    return total


def _at(rows: NDArray[np.uint8], spot: Spot) -> NDArray[Any]:
    return np.ascontiguousarray(rows[:, spot.at : spot.at + spot.size]).view(spot.dtype)[:, 0]


def _in_order(parts: list[tuple[NDArray[np.int64], Columns]], width: int) -> Columns:
    """Rows in the order of their messages."""
    if len(parts) == 1:
        return parts[0][1]
    if not parts:
        none = np.empty(0, np.int64)
        return Columns(none, none, np.empty((0, width)))
    order = np.argsort(np.concatenate([at for at, _ in parts]), kind="stable")
    log, stamps, values = (
        np.concatenate([getattr(c, name) for _, c in parts])[order]
        for name in ("log_ns", "stamp_ns", "values")
    )
    return Columns(log, stamps, values)
