"""JointState as protobuf, by the descriptor that the file itself carries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory

from trueup.episode.container import Schema
from trueup.episode.joint_state import FIELDS, JointState
from trueup.errors import NotAnEpisode


def message_class(schema: Schema) -> type[message.Message]:
    """The class of messages of this schema. Raises NotAnEpisode."""
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
        pool = descriptor_pool.DescriptorPool()
        _add_in_order(pool, {file.name: file for file in files.file})
        kind: type[message.Message] = message_factory.GetMessageClass(
            pool.FindMessageTypeByName(schema.name)
        )
    except (message.DecodeError, KeyError, TypeError, RecursionError) as error:
        raise NotAnEpisode(
            f"the protobuf schema {schema.name!r} cannot be used: {error}", rule="encoding"
        ) from error
    return kind


def reader(schema: Schema) -> Callable[[bytes], JointState]:
    """A reader for messages of this schema. Raises NotAnEpisode."""
    kind = message_class(schema)
    if not {"name", *FIELDS} <= {f.name for f in kind.DESCRIPTOR.fields}:
        raise NotAnEpisode(f"the protobuf message {schema.name!r} is no JointState", rule="message")
    return lambda data: _read(kind, data)


def _add_in_order(
    pool: descriptor_pool.DescriptorPool, files: dict[str, descriptor_pb2.FileDescriptorProto]
) -> None:
    """Add each file after those it depends on, as a pool demands."""
    added: set[str] = set()

    def add(file: descriptor_pb2.FileDescriptorProto) -> None:
        if file.name not in added:
            added.add(file.name)
            for name in file.dependency:
                add(files[name])
            pool.Add(file)

    for file in files.values():
        add(file)


def _read(kind: type[message.Message], data: bytes) -> JointState:
    try:
        state: Any = kind.FromString(data)
    except message.DecodeError as error:
        raise ValueError(str(error)) from error
    values = tuple(list(getattr(state, field)) for field in FIELDS)
    return JointState(_stamp_ns(state), tuple(state.name), values)


def _stamp_ns(state: Any) -> int:
    stamp = state.header.stamp if hasattr(state, "header") else None
    seconds = next((getattr(stamp, k) for k in ("sec", "secs", "seconds") if hasattr(stamp, k)), 0)
    nanoseconds = next(
        (getattr(stamp, k) for k in ("nanosec", "nsec", "nsecs", "nanos") if hasattr(stamp, k)), 0
    )
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
