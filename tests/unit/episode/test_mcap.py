"""Episodes from MCAP: every encoding, irregular times, missing channels, several joints, and each
rule broken."""

import hashlib
import io
import json

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoder
from mcap_ros2.decoder import DecoderFactory as Ros2Decoder

from tests.support.made import T0_NS, arm_layout, episode_bytes, mcap_bytes, plant_document
from trueup.episode.layout import Channel, Field, Layout
from trueup.episode.mcap import read_episode, read_episode_stream
from trueup.episode.role import Role
from trueup.episode.writer import ROS2_DEFINITION, Encoding
from trueup.errors import NotAnEpisode, RoleRefused, TooLarge
from trueup.fit.identify import identify
from trueup.model.plant import Plant

RNG = np.random.default_rng(0)
LAYOUT = arm_layout(3)
OBSERVED, ISSUED = RNG.normal(size=(50, 6)), RNG.normal(size=(50, 3))
PLANT = Plant.from_document(plant_document())


def raw(
    messages,
    metadata=({"role": "adaptation"},),
    encoding="json",
    schema="sensor_msgs/msg/JointState",
):
    """A file of JSON messages (topic, log time, dict)."""
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    schema = writer.register_schema(schema, "jsonschema", b"{}")
    channels = {}
    for topic, log_ns, message in messages:
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, encoding, schema)
        writer.add_message(
            channels[topic],
            log_time=log_ns,
            publish_time=log_ns,
            data=json.dumps(message).encode() if isinstance(message, dict) else message,
        )
    for values in metadata:
        writer.add_metadata("episode", values)
    writer.finish()
    return stream.getvalue()


def stock(data, decoder):
    """What the stock reader decodes on the observation topic."""
    reader = make_reader(io.BytesIO(data), decoder_factories=[decoder])
    return [
        message
        for _, channel, _, message in reader.iter_decoded_messages()
        if channel.topic == "/joint_states"
    ]


def pair(i, q=0.0, u=0.0):
    return [
        ("/joint_states", i, {"name": ["j"], "position": [q], "velocity": [0.0]}),
        ("/joint_commands", i, {"name": ["j"], "effort": [u]}),
    ]


@pytest.mark.parametrize("encoding", list(Encoding))
def test_several_joints_come_back_bit_for_bit(encoding):
    episode = read_episode(
        mcap_bytes(LAYOUT, OBSERVED, ISSUED, encoding=encoding, stage="MIL"), LAYOUT
    )
    assert np.array_equal(episode.observations, OBSERVED)
    assert np.array_equal(episode.commands, ISSUED)
    assert (episode.role, dict(episode.conditions), episode.start_ns, episode.missing) == (
        Role.ADAPTATION,
        {"stage": "MIL"},
        T0_NS,
        (),
    )
    assert episode.period_s == pytest.approx(0.05)


def test_the_arrays_cannot_be_written_to():
    episode = read_episode(episode_bytes(), PLANT.layout)
    with pytest.raises(ValueError, match="read-only"):
        episode.observations[0, 0] = 1.0


def test_the_digest_is_that_of_the_file():
    data = episode_bytes()
    assert read_episode(data, PLANT.layout).digest == hashlib.sha256(data).hexdigest()


def test_the_stock_ros2_reader_reads_what_we_write():
    data = mcap_bytes(LAYOUT, OBSERVED, ISSUED)
    states = stock(data, Ros2Decoder())
    assert [list(m.position) + list(m.velocity) for m in states] == OBSERVED.tolist()
    assert states[1].header.stamp.sec * 10**9 + states[1].header.stamp.nanosec == T0_NS + 50_000_000
    assert list(states[0].name) == ["j0", "j1", "j2"]


def test_the_stock_protobuf_reader_reads_what_we_write():
    states = stock(
        mcap_bytes(LAYOUT, OBSERVED, ISSUED, encoding=Encoding.PROTOBUF), ProtobufDecoder()
    )
    assert [list(m.position) + list(m.velocity) for m in states] == OBSERVED.tolist()


def test_what_the_stock_ros2_writer_writes_is_read():
    from mcap_ros2.writer import Writer as Ros2Writer

    stream = io.BytesIO()
    writer = Ros2Writer(stream)
    schema = writer.register_msgdef("sensor_msgs/msg/JointState", ROS2_DEFINITION)
    for i in range(30):
        header = {"stamp": {"sec": 5, "nanosec": i * 1000}, "frame_id": "base" * (i % 3)}
        writer.write_message(
            "/joint_states",
            schema,
            {
                "header": header,
                "name": ["a", "bcd"],
                "position": [float(i), -1.0],
                "velocity": [],
                "effort": [],
            },
            log_time=i,
        )
        writer.write_message(
            "/joint_commands",
            schema,
            {
                "header": header,
                "name": ["a", "bcd"],
                "position": [],
                "velocity": [],
                "effort": [2.0, float(i)],
            },
            log_time=i,
        )
    writer._writer.add_metadata("episode", {"role": "test"})
    writer.finish()
    layout = Layout(
        (Channel("q", "rad", Field.POSITION, "a"),), (Channel("u", "N·m", Field.EFFORT, "bcd"),)
    )
    result = read_episode(stream.getvalue(), layout)
    assert (
        result.observations[:, 0].tolist()
        == result.commands[:, 0].tolist()
        == [float(i) for i in range(30)]
    )
    assert np.diff(result.t_s) == pytest.approx(1e-6)


def test_irregular_times_and_gaps_are_kept():
    stamps = T0_NS + np.cumsum(RNG.integers(1_000_000, 9_000_000, 50))
    stamps[25:] += 2_000_000_000
    episode = read_episode(mcap_bytes(LAYOUT, OBSERVED, ISSUED, stamps_ns=stamps), LAYOUT)
    assert np.array_equal(np.rint(episode.t_s * 1e9), stamps - stamps[0])
    assert episode.gaps.tolist() == [25]


def test_a_missing_channel_is_a_column_of_nan_and_is_named():
    wider = Layout(
        (*LAYOUT.observations, Channel("vx", "rad/s", Field.VELOCITY, "absent")), LAYOUT.commands
    )
    episode = read_episode(mcap_bytes(LAYOUT, OBSERVED, ISSUED), wider)
    assert episode.missing == ("vx",)
    assert np.isnan(episode.observations[:, -1]).all()


def test_a_few_messages_that_say_nothing_are_left_out_and_named():
    observed, stamps = OBSERVED.copy(), T0_NS + np.arange(len(OBSERVED)) * 10_000_000
    observed[7, 0], observed[9, 1] = np.nan, np.inf
    stamps[20] = stamps[19]
    episode = read_episode(mcap_bytes(LAYOUT, observed, ISSUED, stamps_ns=stamps), LAYOUT)
    kept = np.delete(np.arange(len(OBSERVED)), [7, 9, 20])
    np.testing.assert_array_equal(episode.observations, OBSERVED[kept])
    first, second = (c.name for c in LAYOUT.observations[:2])
    assert [(str(o.reason), o.channel, o.messages) for o in episode.omissions] == [
        ("not_finite", first, 1),
        ("not_finite", second, 1),
        ("repeated_stamp", None, 1),
        ("repeated_stamp", None, 1),
    ]
    assert episode.omissions[0].from_s == pytest.approx(0.07, abs=1e-6)


def test_observations_that_happened_before_their_stamps_are_read_so():
    data = mcap_bytes(LAYOUT, OBSERVED, ISSUED)
    plain = read_episode(data, LAYOUT)
    late_s = 2.0 * plain.period_s
    shifted = read_episode_stream(io.BytesIO(data), len(data), LAYOUT, late_s=late_s)
    np.testing.assert_array_equal(shifted.observations, plain.observations[2:])
    np.testing.assert_allclose(shifted.commands, plain.commands[:-2])


def test_there_may_be_one_command_less_than_states():
    episode = read_episode(mcap_bytes(LAYOUT, OBSERVED, ISSUED[:-1]), LAYOUT)
    assert np.array_equal(episode.commands[:-1], ISSUED[:-1])
    assert np.array_equal(episode.commands[-1], ISSUED[-2])


def test_a_command_acts_from_its_stamp_on_and_samples_before_the_first_are_dropped():
    states = [
        ("/joint_states", i * 10, {"name": ["j"], "position": [float(i)], "velocity": [0.0]})
        for i in range(1, 8)
    ]
    orders = [("/joint_commands", t, {"name": ["j"], "effort": [float(t)]}) for t in (25, 40, 41)]
    episode = read_episode(raw(sorted(states + orders, key=lambda m: m[1])), PLANT.layout)
    assert episode.observations[:, 0].tolist() == [3.0, 4.0, 5.0, 6.0, 7.0]
    assert episode.commands[:, 0].tolist() == [25.0, 0.1 * 40.0 + 0.9 * 41.0, 41.0, 41.0, 41.0]


def test_a_command_between_samples_acts_for_its_part_of_the_interval():
    """Fast and offset commands: the identified drive gain stays true, which it does not if a
    sample's command is held."""
    rng, dt, n = np.random.default_rng(0), 10_000_000, 4000
    fine = rng.uniform(-1, 1, n + 5)
    states = np.zeros((n, 2))
    for i in range(n - 1):
        states[i + 1] = PLANT.update(
            states[i : i + 1], fine[i : i + 1, None], (1.25, 0.62, 0.82), dt / 1e9
        )[0]
    for offset in (0, 2):
        every = [(i * dt, states[i]) for i in range(offset, n, 5)]
        messages = [
            ("/joint_states", 1 + t, {"name": ["j"], "position": [q], "velocity": [v]})
            for t, (q, v) in every
        ]
        messages += [
            ("/joint_commands", 1 + i * dt, {"name": ["j"], "effort": [fine[i]]}) for i in range(n)
        ]
        episode = read_episode(raw(sorted(messages, key=lambda m: m[1])), PLANT.layout)
        assert identify(PLANT, [episode])[1].parameters["b"] == pytest.approx(0.82, rel=0.03)


@pytest.mark.parametrize(
    ("channel", "said"),
    [(Channel("q", "m", Field.POSITION, "other"), "q"), (Channel("u", "V", Field.VELOCITY), "u")],
)
def test_a_position_or_a_command_that_the_log_lacks_is_refused_by_name(channel, said):
    observations = (
        (channel, PLANT.layout.observations[1]) if said == "q" else PLANT.layout.observations
    )
    commands = (channel,) if said == "u" else PLANT.layout.commands
    with pytest.raises(NotAnEpisode) as refused:
        read_episode(episode_bytes(), Layout(observations, commands))
    assert (refused.value.facts["rule"], refused.value.facts["channel"]) == ("samples", said)


def test_two_clocks_are_not_mixed():
    messages = []
    for i in range(1, 30):
        header = {"stamp": {"sec": 0, "nanosec": i}}
        messages += [
            ("/joint_states", i * 10**9, {"name": ["j"], "position": [0.1 * i], "velocity": [0.0]})
        ]
        messages += [
            ("/joint_commands", i * 10**9, {"header": header, "name": ["j"], "effort": [float(i)]})
        ]
    assert read_episode(raw(messages), PLANT.layout).commands[:, 0].tolist() == [
        float(i) for i in range(1, 30)
    ]


def test_log_time_counts_where_every_stamp_is_zero():
    episode = read_episode(raw([m for i in range(1, 5) for m in pair(i * 10**9)]), PLANT.layout)
    assert episode.t_s.tolist() == [0.0, 1.0, 2.0, 3.0]


CDR_EMPTY = b"\0\1\0\0" + bytes(32)

REFUSED = {
    "no role": (raw([m for i in range(3) for m in pair(i + 1)], metadata=()), "role"),
    "two roles": (
        raw(
            [m for i in range(3) for m in pair(i + 1)],
            metadata=({"role": "test"}, {"role": "adaptation"}),
        ),
        "role",
    ),
    "an unknown role": (
        raw([m for i in range(3) for m in pair(i + 1)], metadata=({"role": "anything"},)),
        "role",
    ),
    "no observation topic": (raw([m for i in range(3) for m in pair(i + 1)][1::2]), "topic"),
    "no command topic": (raw([m for i in range(3) for m in pair(i + 1)][::2]), "topic"),
    "no message": (raw([]), "topic"),
    "a clock that runs back": (raw([m for i in (1, 2, 4, 3, 5) for m in pair(i)]), "clock"),
    "a stamp twice": (raw([m for i in (1, 2, 2, 3) for m in pair(i)]), "clock"),
    "one sample": (raw(pair(1)), "samples"),
    "a hole in a channel": (
        raw(
            [
                *pair(1),
                ("/joint_states", 2, {"name": ["j"], "position": [], "velocity": [0.0]}),
                *pair(3),
            ]
        ),
        "finite",
    ),
    "null as a number": (
        raw(
            [
                *pair(1),
                ("/joint_states", 2, {"name": ["j"], "position": [None], "velocity": [0.0]}),
                *pair(3),
            ]
        ),
        "finite",
    ),
    "no declared observation": (
        raw([m for i in range(1, 4) for m in (("/joint_states", i, {"name": ["j"]}), pair(i)[1])]),
        "samples",
    ),
    "an unknown encoding": (
        raw([m for i in range(3) for m in pair(i + 1)], encoding="xml"),
        "encoding",
    ),
    "CDR that is none": (
        raw([("/joint_states", 1, b"\0\1\0\0\1"), ("/joint_commands", 1, b"")], encoding="cdr"),
        "message",
    ),
    "JSON that is none": (
        raw([("/joint_states", 1, b"{"), ("/joint_commands", 1, b"{}")]),
        "message",
    ),
    "JSON of another shape": (
        raw([("/joint_states", 1, b"[1]"), ("/joint_commands", 1, b"{}")]),
        "message",
    ),
    "a text as a number": (
        raw([*pair(1), ("/joint_states", 2, {"name": ["j"], "position": ["far"]})]),
        "message",
    ),
    "no overlap in time": (
        raw(
            [
                pair(1)[0],
                pair(2)[0],
                *(("/joint_commands", i, {"name": ["j"], "effort": [0.0]}) for i in (7, 8)),
            ]
        ),
        "clock",
    ),
    "a clock that was set": (raw([*pair(1), *pair(2), *pair(10**17)]), "clock"),
    "infinity everywhere": (
        raw(
            [
                m
                for i in (1, 2)
                for m in (
                    ("/joint_states", i, {"name": ["j"], "position": [0.0], "velocity": [1e999]}),
                    pair(i)[1],
                )
            ]
        ),
        "message",
    ),
    "a log time beyond 64 bits": (
        raw(
            [
                (t, 2**63 + i, CDR_EMPTY)
                for i in range(2)
                for t in ("/joint_states", "/joint_commands")
            ],
            encoding="cdr",
        ),
        "clock",
    ),
    "CDR of another type": (
        raw([("/joint_states", 1, CDR_EMPTY)], encoding="cdr", schema="control_msgs/msg/JointJog"),
        "encoding",
    ),
    "a stamp beyond 64 bits": (
        raw(
            [
                (
                    "/joint_states",
                    1,
                    {"header": {"stamp": {"sec": 10**30}}, "name": ["j"], "position": [0.0]},
                )
            ]
        ),
        "clock",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_episode_is_refused_with_its_rule(name):
    data, rule = REFUSED[name]
    with pytest.raises(NotAnEpisode) as refused:
        read_episode(data, PLANT.layout)
    assert refused.value.facts["rule"] == rule


def test_a_cdr_message_that_declares_too_much_is_refused():
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
    for topic in ("/joint_states", "/joint_commands"):
        channel = writer.register_channel(topic, "cdr", schema)
        writer.add_message(
            channel,
            log_time=1,
            publish_time=1,
            data=b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0\0\0\0" + b"\xff\xff\xff\x7f",
        )
    writer.add_metadata("episode", {"role": "test"})
    writer.finish()
    with pytest.raises(NotAnEpisode) as refused:
        read_episode(stream.getvalue(), LAYOUT)
    assert refused.value.facts["rule"] == "message"


def test_conditions_are_a_page_of_text_at_most():
    messages = [m for i in range(1, 4) for m in pair(i)]
    for metadata in (
        {"role": "test", "note": "x" * 5000},
        {"role": "test", **{f"k{i}": "" for i in range(99)}},
    ):
        with pytest.raises(TooLarge) as refused:
            read_episode(raw(messages, metadata=(metadata,)), PLANT.layout)
        assert refused.value.facts["limit"] == "conditions"


def test_unchunked_messages_are_gathered(monkeypatch):
    stream = io.BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start()
    schema = writer.register_schema("s", "jsonschema", b"{}")
    channels = [
        writer.register_channel(t, "json", schema) for t in ("/joint_states", "/joint_commands")
    ]
    for i in range(1, 2000):
        for channel, (_, t, message) in zip(channels, pair(i, q=float(i)), strict=True):
            writer.add_message(
                channel, log_time=t, publish_time=t, data=json.dumps(message).encode()
            )
    writer.add_metadata("episode", {"role": "test"})
    writer.finish()
    for gather in (1, 5000, 1 << 20):
        monkeypatch.setattr("trueup.episode.walk.GATHER_BYTES", gather)
        assert read_episode(stream.getvalue(), PLANT.layout).observations[:, 0].tolist() == [
            float(i) for i in range(1, 2000)
        ]


def test_a_role_is_required():
    episode = read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)
    assert episode.require(Role.VALIDATION) is episode
    with pytest.raises(RoleRefused):
        episode.require(Role.ADAPTATION)
