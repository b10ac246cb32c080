"""Copy messages of a recording into another one, byte by byte."""

from __future__ import annotations

from collections.abc import Collection

from mcap.reader import McapReader
from mcap.writer import Writer


def copy_messages(
    source: McapReader,
    to: Writer,
    topics: Collection[str] | None = None,
    begin_ns: int | None = None,
    end_ns: int | None = None,
) -> None:
    """Copy the messages of some topics, or of all, whose log time is from `begin_ns` on and before
    `end_ns`, in the order of the file."""
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for schema, channel, message in source.iter_messages(topics, log_time_order=False):
        if (begin_ns is not None and message.log_time < begin_ns) or (
            end_ns is not None and message.log_time >= end_ns
        ):
            continue
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = to.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            known = schemas[channel.schema_id]
            channels[channel.id] = to.register_channel(
                channel.topic, channel.message_encoding, known, dict(channel.metadata)
            )
        to.add_message(
            channels[channel.id],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )


def copy_rest(source: McapReader, to: Writer) -> None:
    """Copy metadata and attachments."""
    for metadata in source.iter_metadata():
        to.add_metadata(metadata.name, dict(metadata.metadata))
    for attachment in source.iter_attachments():
        to.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )
