"""A recording whose stamps and log times contradict each other is warned of; latency is no
contradiction."""

import io

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from tests.support.made import episode_bytes, plant_document
from trueup.collect.measured import measured
from trueup.episode.mcap import read_episode
from trueup.model.plant import Plant

PLANT = Plant.from_document(plant_document())
S = 1_000_000_000


def logged(at, samples=400):
    """The warnings of 20 s of samples whose log times [ns] are made of their stamps."""
    return [
        w
        for w in measured(
            PLANT, read_episode(relogged(episode_bytes(samples=samples), at), PLANT.layout)
        )["warnings"]
        if "clock" in w
    ]


def relogged(data, at):
    """The recording with other log times: `at` makes them of an array of the old ones, for each
    topic."""
    reader, out = make_reader(io.BytesIO(data)), io.BytesIO()
    messages = list(reader.iter_messages(log_time_order=False))
    first = min(m.log_time for *_, m in messages)
    times = {}
    for topic in {c.topic for _, c, _ in messages}:
        of = np.array([m.log_time for _, c, m in messages if c.topic == topic], np.int64)
        times[topic] = iter(first + at(of - first))
    writer = Writer(out)
    writer.start()
    schemas, channels = {}, {}
    for schema, channel, message in messages:
        if channel.topic not in channels:
            schemas[schema.id] = schemas.get(schema.id) or writer.register_schema(
                schema.name, schema.encoding, schema.data
            )
            channels[channel.topic] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[schema.id]
            )
        writer.add_message(
            channels[channel.topic],
            int(next(times[channel.topic])),
            message.data,
            message.publish_time,
        )
    for metadata in make_reader(io.BytesIO(data)).iter_metadata():
        writer.add_metadata(metadata.name, metadata.metadata)
    writer.finish()
    return out.getvalue()


SOUND = {
    "the same": lambda t: t,
    "a constant latency of a minute": lambda t: t + 60 * S,
    "jitter of 200 ms": lambda t: t + np.random.default_rng(0).integers(0, S // 5, len(t)),
    "written in blocks of half a second": lambda t: (t // (S // 2) + 1) * (S // 2),
    "a clock that drifts by 100 ppm": lambda t: t + t // 10_000,
}
AMISS = {
    "standing still": (lambda t: 0 * t, "stand still"),
    "twice as fast": (lambda t: 2 * t, "come apart by"),
    "half as fast": (lambda t: t // 2, "come apart by"),
    "backwards": (lambda t: t[-1] - t, "go back by"),
    "in another order": (lambda t: np.random.default_rng(0).permutation(t), "go back by"),
    "set while recording": (lambda t: t + 3600 * S * (t > t[-1] // 2), "come apart by"),
}


@pytest.mark.parametrize("name", SOUND)
def test_latency_is_no_contradiction(name):
    assert logged(SOUND[name]) == []


@pytest.mark.parametrize("name", AMISS)
def test_clocks_that_contradict_each_other_are_told_of_on_each_topic(name):
    at, words = AMISS[name]
    doubts = logged(at)
    assert [
        topic in w for topic, w in zip(("/joint_states", "/joint_commands"), doubts, strict=True)
    ] == [True, True]
    assert all(words in w for w in doubts)


def test_a_short_recording_whose_log_stands_still_is_told_of():
    assert len(logged(lambda t: 0 * t, samples=10)) == 2
