"""Overlay: a recording with models' predictions as further topics, as Foxglove and PlotJuggler show
them beside the recorded ones.

    /trueup/<model>/prediction  JointState: the observations that a model predicts
    /trueup/<model>/residual    JointState: observed less predicted
    /trueup/applied             JointState: commands as they were applied; where nobody recorded
                                it, what the declared limits leave of the issued ones
    /trueup/regions             JSON: the regions that a sample is in, one whenever they change

The recorded messages, metadata and attachments are copied as they are. Stamps of what is added are
those of the samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import BinaryIO

import numpy as np
import orjson
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from trueup.episode.copying import copy_messages, copy_rest
from trueup.episode.episode import Episode
from trueup.episode.writer import ROS2_DEFINITION, FieldColumns, encode_cdr

Array = NDArray[np.float64]
REGIONS, APPLIED = "/trueup/regions", "/trueup/applied"
REGIONS_SCHEMA = {
    "type": "object",
    "properties": {"regions": {"type": "array", "items": {"type": "string"}}},
}


def write_overlay(
    to: BinaryIO,
    recorded: bytes,
    episode: Episode,
    predictions: Mapping[str, Array],
    regions: Mapping[str, NDArray[np.bool_]],
) -> None:
    """Write the recording `recorded` that `episode` was read from, with predictions `(samples,
    observations)` by the model's name, and regions `(samples,)` by theirs.
    """
    writer = Writer(to, compression=CompressionType.ZSTD)
    source = make_reader(BytesIO(recorded))
    writer.start(profile=source.get_header().profile, library="trueup")
    copy_messages(source, writer)
    copy_rest(source, writer)
    stamps = (episode.start_ns + np.rint(episode.t_s * 1e9).astype(np.int64)).tolist()
    schema = writer.register_schema(
        "sensor_msgs/msg/JointState", "ros2msg", ROS2_DEFINITION.encode()
    )
    observed, ordered = (
        FieldColumns(channels)
        for channels in (episode.layout.observations, episode.layout.commands)
    )
    added = [(APPLIED, ordered, episode.applied_commands)]
    for name, predicted in predictions.items():
        added += [
            (f"/trueup/{name}/prediction", observed, predicted),
            (f"/trueup/{name}/residual", observed, episode.observations - predicted),
        ]
    for topic, rows, values in added:
        channel = writer.register_channel(topic, "cdr", schema)
        for i, stamp in enumerate(stamps):
            data = encode_cdr(stamp, rows.joints, rows.fields(values[i]))
            writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp, sequence=i)
    channel = writer.register_channel(
        REGIONS,
        "json",
        writer.register_schema("trueup.Regions", "jsonschema", orjson.dumps(REGIONS_SCHEMA)),
    )
    before: list[str] | None = None
    for i, stamp in enumerate(stamps):
        now = [name for name, inside in regions.items() if inside[i]]
        if now != before:
            writer.add_message(
                channel,
                log_time=stamp,
                data=orjson.dumps({"regions": now}),
                publish_time=stamp,
                sequence=i,
            )
            before = now
    writer.finish()  # type: ignore[no-untyped-call]
