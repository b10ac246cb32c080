"""JointState messages, and topics of them as columns."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Message, MessageBlock
from trueup.episode.layout import Channel, Field
from trueup.errors import NotAnEpisode

FIELDS = tuple(Field)


@dataclass(frozen=True, slots=True)
class JointState:
    """One message: stamp [ns], joint names, and for each field its values."""

    stamp_ns: int
    names: tuple[str, ...]
    values: tuple[Sequence[float], ...]

    def pick(self, channels: Sequence[Channel]) -> list[float]:
        """The value of each channel, nan where the message has none."""
        return [self._one(c) for c in channels]

    def _one(self, channel: Channel) -> float:
        values = self.values[FIELDS.index(channel.field)]
        at = joint_index(self.names, channel.joint)
        return float(values[at]) if at is not None and at < len(values) else float("nan")


def joint_index(names: tuple[str, ...], joint: str | None) -> int | None:
    """The index of a joint in a message, of the first one if `joint` is None; None if the joint is
    not there."""
    if joint is None:
        return 0
    return names.index(joint) if joint in names else None


@dataclass(frozen=True, slots=True)
class Columns:
    """Stamps and values of one topic: log time and header stamp [ns] `(n,)`, values `(n,
    channels)`."""

    log_ns: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    values: NDArray[np.float64]


# what reading a message raises that is not what its topic says
UNREADABLE = (ValueError, TypeError, LookupError, struct.error, AttributeError, OverflowError)


def decode_each(
    block: MessageBlock,
    messages: Iterable[Message],
    channels: Sequence[Channel],
    read: Callable[[bytes], JointState],
) -> Columns:
    """Columns of messages read one by one. Raises NotAnEpisode for one that `read` refuses."""
    log, stamps, rows = [], [], []
    for start, length, log_ns in messages:
        try:
            state = read(block.data[start : start + length])
            row = state.pick(channels)
        except UNREADABLE as error:
            raise NotAnEpisode(
                f"a message is no JointState: {error}",
                rule="message",
                byte=block.byte,
                log_time_ns=str(log_ns),
            ) from error
        log.append(log_ns)
        stamps.append(state.stamp_ns)
        rows.append(row)
    return as_columns(block, log, stamps, rows, len(channels))


def as_columns(
    block: MessageBlock,
    log: Sequence[int],
    stamps: Sequence[int],
    rows: Sequence[Sequence[float]],
    width: int,
) -> Columns:
    """Columns of rows that were read one by one, each of `width` values. Raises NotAnEpisode where
    a time does not fit."""
    try:
        return Columns(
            np.array(log, np.int64),
            np.array(stamps, np.int64),
            np.array(rows, np.float64).reshape(len(rows), width),
        )
    except OverflowError as error:
        raise NotAnEpisode(
            "a time stamp does not fit 64 bits", rule="clock", byte=block.byte
        ) from error
