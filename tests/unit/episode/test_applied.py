"""Issued and applied commands: a recording may carry both, and what was applied is then read,
aligned, shown and held against what the declared limits leave."""

from io import BytesIO

import numpy as np
import orjson
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from tests.support.made import T0_NS, plant_document
from trueup.collect.measured import measured
from trueup.diagnose.traces import traces
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode
from trueup.episode.overlay import write_overlay
from trueup.episode.role import Role
from trueup.episode.telemetry import telemetry_to_mcap
from trueup.episode.writer import Encoding, write_episode
from trueup.errors import NotAnEpisode
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal
from trueup_pages.foxglove import layout

PLANT = Plant.from_document(plant_document())
SAMPLES = 60
STAMPS = T0_NS + (50_000_000 * np.arange(SAMPLES)).astype(np.int64)
ISSUED = np.linspace(-1.5, 1.5, SAMPLES)[:, None]
OBSERVED = np.stack([np.sin(0.1 * np.arange(SAMPLES)), np.cos(0.1 * np.arange(SAMPLES))], axis=1)


def recording(applied, plant=PLANT, encoding=Encoding.CDR):
    out = BytesIO()
    write_episode(
        out,
        stamps_ns=STAMPS,
        observations=OBSERVED,
        commands=ISSUED,
        layout=plant.layout,
        role=Role.ADAPTATION,
        conditions={},
        encoding=encoding,
        applied=applied,
    )
    return out.getvalue()


@pytest.mark.parametrize("encoding", list(Encoding))
def test_what_was_applied_is_read_beside_what_was_issued(encoding):
    applied = np.clip(ISSUED, -0.8, 0.8)
    episode = read_episode(recording(applied, encoding=encoding), PLANT.layout)
    np.testing.assert_array_equal(episode.commands, ISSUED)
    np.testing.assert_array_equal(episode.applied, applied)
    np.testing.assert_array_equal(episode.applied_commands, applied)
    with pytest.raises(ValueError, match="read-only"):
        episode.applied[0] = 1.0


def test_without_it_the_declared_limits_say_what_is_applied():
    episode = read_episode(recording(None), PLANT.layout)
    assert episode.applied is None
    np.testing.assert_array_equal(episode.applied_commands, np.clip(ISSUED, -1.0, 1.0))


def test_the_same_samples_are_the_same_whether_or_not_somebody_logged_what_was_applied():
    plain, both = (
        read_episode(recording(applied), PLANT.layout) for applied in (None, 0.5 * ISSUED)
    )
    assert plain.samples_digest == both.samples_digest


def test_a_plant_may_name_the_topic():
    topics = {"observation": "/joint_states", "command": "/u", "applied": "/drive/u"}
    plant = Plant.from_document({**plant_document(), "topics": topics})
    assert plant.layout.applied_topic == "/drive/u"
    data = recording(0.5 * ISSUED, plant)
    np.testing.assert_array_equal(read_episode(data, plant.layout).applied, 0.5 * ISSUED)
    unnamed = Plant.from_document({**plant_document(), "topics": {**topics, "applied": "/other"}})
    assert read_episode(data, unnamed.layout).applied is None


def test_before_its_first_message_what_was_applied_is_not_known():
    # the drive's topic began ten samples later
    source, cut = make_reader(BytesIO(recording(0.5 * ISSUED))), BytesIO()
    writer = Writer(cut)
    writer.start(profile="ros2")
    channels: dict[str, int] = {}
    for schema, channel, message in source.iter_messages():
        if channel.topic not in channels:
            known = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, "cdr", known)
        if channel.topic == PLANT.layout.applied_topic and message.log_time < STAMPS[10]:
            continue
        writer.add_message(
            channels[channel.topic], message.log_time, message.data, message.publish_time
        )
    writer.add_metadata("episode", {"role": "adaptation"})
    writer.finish()
    episode = read_episode(cut.getvalue(), PLANT.layout)
    assert np.isnan(episode.applied[:10]).all()
    np.testing.assert_array_equal(episode.applied[10:], 0.5 * ISSUED[10:])
    record = measured(PLANT, episode)["applied"]["u"]
    assert record["share"] == pytest.approx(1.0)


def test_many_values_that_are_no_numbers_are_refused():
    broken = 0.5 * ISSUED
    broken[: len(broken) // 5] = np.inf
    with pytest.raises(NotAnEpisode) as refused:
        read_episode(recording(broken), PLANT.layout)
    assert refused.value.facts["rule"] == "finite"
    with pytest.raises(NotAnEpisode, match="shape of issued"):
        Episode(
            np.arange(3.0), np.zeros((3, 1)), np.zeros((3, 2)), PLANT.layout, Role.TEST, {}, 0, "",
            (), np.zeros((2, 1)),
        )  # fmt: skip


def test_what_the_drive_did_besides_the_declared_limits_is_said():
    honest, weak = (
        read_episode(recording(np.clip(ISSUED, -limit, limit)), PLANT.layout)
        for limit in (1.0, 0.8)
    )
    assert measured(PLANT, honest)["applied"] == {"u": {"share": 0.0, "largest": 0.0}}
    record = measured(PLANT, weak)
    assert record["applied"]["u"]["largest"] == pytest.approx(0.2)
    assert record["applied"]["u"]["share"] == pytest.approx(np.mean(np.abs(ISSUED) > 0.8))
    assert any("something in the drive limits" in w for w in record["warnings"])
    nothing = read_episode(recording(None), PLANT.layout)
    assert measured(PLANT, nothing)["applied"] is None


def test_pictures_have_both_where_they_differ():
    columns = list(enumerate(PLANT.layout.observations))
    for applied, words in ((0.5 * ISSUED, "as recorded"), (None, "by the declared limits")):
        episode = read_episode(recording(applied), PLANT.layout)
        (drawn,) = traces(PLANT, [episode], {"nominal": Nominal(PLANT)}, columns)
        (command,) = drawn["commands"]
        assert drawn["applied"] == words
        np.testing.assert_allclose(command["issued"], ISSUED[:, 0], rtol=1e-4)
        np.testing.assert_allclose(command["applied"], episode.applied_commands[:, 0], rtol=1e-4)
    quiet = read_episode(recording(ISSUED), PLANT.layout)
    (drawn,) = traces(PLANT, [quiet], {"nominal": Nominal(PLANT)}, columns)
    assert drawn["commands"][0]["applied"] is None


def test_the_overlay_and_its_layout_show_both():
    data = recording(0.5 * ISSUED)
    episode, written = read_episode(data, PLANT.layout), BytesIO()
    write_overlay(written, data, episode, {"v1": OBSERVED}, {})
    renamed = Plant.from_document({**plant_document(), "topics": {"applied": "/trueup/applied"}})
    again = read_episode(written.getvalue(), renamed.layout)
    np.testing.assert_array_equal(again.applied, 0.5 * ISSUED)
    plots = layout(plant_document(), ["v1"])["configById"]
    paths = [line["value"] for line in plots["Plot!command-0"]["paths"]]
    assert paths == ["/joint_commands.effort[0]", "/trueup/applied.effort[0]"]


def test_telemetry_may_carry_both():
    batch = {
        "start_ns": str(T0_NS),
        "t_s": [0.0, 0.05, 0.1],
        "observations": {"q": [0.0, 0.1, 0.2], "v": [0.0, 0.0, 0.0]},
        "commands": {"u": [0.0, 0.5, 1.5]},
        "applied": {"u": [0.0, 0.5, 0.9]},
    }
    out = BytesIO()
    telemetry_to_mcap(orjson.dumps(batch), PLANT.layout, out)
    episode = read_episode(out.getvalue(), PLANT.layout)
    assert episode.applied[:, 0].tolist() == [0.0, 0.5, 0.9]
    for wrong in ({"u": [0.0]}, {"w": [0.0, 0.0, 0.0]}, None):
        with pytest.raises(NotAnEpisode) as refused:
            telemetry_to_mcap(orjson.dumps({**batch, "applied": wrong}), PLANT.layout, BytesIO())
        assert refused.value.facts["rule"] == "applied"
