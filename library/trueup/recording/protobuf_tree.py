"""Protobuf messages of any type as trees, by the descriptor that the log carries."""

from __future__ import annotations

from typing import Any

from google.protobuf import message
from google.protobuf.descriptor import FieldDescriptor

DEEPEST = 32


def tree_of(item: message.Message, depth: int = 0) -> dict[str, Any]:
    """The fields of a message, of those that it leaves out their defaults. Raises ValueError."""
    if depth > DEEPEST:
        raise ValueError("its types are nested too deeply")
    tree: dict[str, Any] = {}
    for field in item.DESCRIPTOR.fields:
        value = getattr(item, field.name)
        is_message = field.type in (FieldDescriptor.TYPE_MESSAGE, FieldDescriptor.TYPE_GROUP)
        if field.is_repeated:
            if is_message and field.message_type.GetOptions().map_entry:
                continue
            tree[field.name] = [tree_of(x, depth + 1) for x in value] if is_message else list(value)
        elif not is_message:
            tree[field.name] = value
        elif item.HasField(field.name):
            tree[field.name] = tree_of(value, depth + 1)
    return tree
