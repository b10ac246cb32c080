"""Overlay: a recording with what models say of it as further topics, as Foxglove and PlotJuggler show them beside the recorded ones.

    /trueup/<model>/prediction   JointState: the observations that a model predicts
    /trueup/<model>/residual     JointState: observed less predicted
    /trueup/regions              JSON: the regions that a sample is in, a message whenever they change

The recorded messages, metadata and attachments are copied as they are. Stamps of what is added are those of the samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import BinaryIO

import numpy as np
import orjson
from mcap.reader import McapReader, make_reader
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.episode.writer import ROS2_DEFINITION, Rows, encode_cdr

Array = NDArray[np.float64]
REGIONS = "/trueup/regions"
REGIONS_SCHEMA = {"type": "object", "properties": {"regions": {"type": "array", "items": {"type": "string"}}}}


def write_overlay(
    to: BinaryIO, recorded: bytes, episode: Episode, predictions: Mapping[str, Array], regions: Mapping[str, NDArray[np.bool_]]
) -> None:
    """Write the recording `recorded` that `episode` was read from, with predictions `(samples, observations)` by the model's name, and
    regions `(samples,)` by theirs.
    """
    writer = Writer(to, compression=CompressionType.ZSTD)
    source = make_reader(BytesIO(recorded))
    writer.start(profile=source.get_header().profile, library="trueup")
    _copy(source, writer)
    stamps = (episode.start_ns + np.rint(episode.t_s * 1e9).astype(np.int64)).tolist()
    schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", ROS2_DEFINITION.encode())
    rows = Rows(episode.layout.observations)
    for name, predicted in predictions.items():
        for what, values in (("prediction", predicted), ("residual", episode.observations - predicted)):
            channel = writer.register_channel(f"/trueup/{name}/{what}", "cdr", schema)
            for i, stamp in enumerate(stamps):
                data = encode_cdr(stamp, rows.joints, rows.fields(values[i]))
                writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp, sequence=i)
    channel = writer.register_channel(REGIONS, "json", writer.register_schema("trueup.Regions", "jsonschema", orjson.dumps(REGIONS_SCHEMA)))
    before: list[str] | None = None
    for i, stamp in enumerate(stamps):
        now = [name for name, inside in regions.items() if inside[i]]
        if now != before:
            writer.add_message(channel, log_time=stamp, data=orjson.dumps({"regions": now}), publish_time=stamp, sequence=i)
            before = now
    writer.finish()  # type: ignore[no-untyped-call]


def _copy(source: McapReader, writer: Writer) -> None:
    """Everything that was recorded, in its order."""
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for schema, channel, message in source.iter_messages(log_time_order=False):
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            known = schemas[channel.schema_id]
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, known, dict(channel.metadata))
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
    for metadata in source.iter_metadata():
        writer.add_metadata(metadata.name, dict(metadata.metadata))
    for attachment in source.iter_attachments():
        writer.add_attachment(attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data)
