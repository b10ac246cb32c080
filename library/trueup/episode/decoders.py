"""The decoder for a topic, by its encoding."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import orjson

from trueup.episode.cdr import ROS2_NAMES, decode_cdr, read_cdr
from trueup.episode.container import Message, MessageBlock, Topic
from trueup.episode.joint_state import FIELDS, Columns, JointState, decode_each
from trueup.episode.layout import Channel
from trueup.errors import NotAnEpisode

Decoder = Callable[[MessageBlock, list[Message], Sequence[Channel]], Columns]


def decoder(topic: Topic) -> Decoder:
    """The decoder for a topic's encoding. Raises NotAnEpisode."""
    read = message_reader(topic)
    if topic.encoding == "cdr":
        return decode_cdr
    return lambda block, messages, channels: decode_each(block, messages, channels, read)


def message_reader(topic: Topic) -> Callable[[bytes], JointState]:
    """The function that reads one message of a topic. Raises NotAnEpisode."""
    if topic.encoding == "cdr":
        if topic.schema is not None and topic.schema.name not in ROS2_NAMES:
            raise NotAnEpisode(
                f"topic {topic.name} carries {topic.schema.name!r}, not JointState",
                rule="encoding",
                topic=topic.name,
            )
        return read_cdr
    if topic.encoding == "json":
        return _read_json
    if topic.encoding == "protobuf" and topic.schema is not None:
        from trueup.episode.protobuf import reader  # noqa: PLC0415  (protobuf loads slowly, few logs need it)

        return reader(topic.schema)
    raise NotAnEpisode(
        f"topic {topic.name} is encoded as {topic.encoding!r}; cdr, json and protobuf are read",
        rule="encoding",
        topic=topic.name,
    )


def _read_json(data: bytes) -> JointState:
    message = orjson.loads(data)
    stamp = (message.get("header") or {}).get("stamp") or {}
    values = tuple([_number(x) for x in message.get(f) or ()] for f in FIELDS)
    return JointState(_stamp_ns(stamp), tuple(map(str, message.get("name") or ())), values)


def _number(value: object) -> float:
    return float("nan") if value is None else float(value)  # type: ignore[arg-type]


def _stamp_ns(stamp: dict[str, int]) -> int:
    seconds = next((stamp[k] for k in ("sec", "secs", "seconds") if k in stamp), 0)
    nanoseconds = next((stamp[k] for k in ("nanosec", "nsec", "nsecs", "nanos") if k in stamp), 0)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
