"""A recording with what models say of it: what was recorded is there as it was, and what is added
stands at its samples."""

from io import BytesIO
from itertools import pairwise

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tests.support.made import episode_bytes, plant_document
from trueup.diagnose.regions import regions_of_samples
from trueup.episode.mcap import read_episode
from trueup.episode.overlay import write_overlay
from trueup.episode.writer import Encoding
from trueup.model.plant import Plant


@pytest.fixture(params=list(Encoding))
def made(request):
    plant = Plant.from_document(plant_document())
    recorded = episode_bytes(encoding=request.param, machine="a bench")
    episode = read_episode(recorded, plant.layout)
    predicted = episode.observations + np.array([0.5, -0.25])
    written = BytesIO()
    write_overlay(written, recorded, episode, {"v3": predicted}, regions_of_samples(plant, episode))
    return plant, recorded, episode, written.getvalue()


def messages(data, topic):
    return [
        (m.log_time, m.data) for _, _, m in make_reader(BytesIO(data)).iter_messages(topics=[topic])
    ]


def test_what_was_recorded_is_copied_as_it_was(made):
    plant, recorded, episode, written = made
    for topic in ("/joint_states", "/joint_commands"):
        assert messages(written, topic) == messages(recorded, topic)
    again = read_episode(written, plant.layout)
    np.testing.assert_array_equal(again.observations, episode.observations)
    assert (again.role, again.conditions) == (episode.role, episode.conditions)


def test_predictions_and_residuals_stand_at_their_samples(made):
    _, _, episode, written = made
    reader = make_reader(BytesIO(written), decoder_factories=[DecoderFactory()])
    rows = [d for *_, d in reader.iter_decoded_messages(topics=["/trueup/v3/residual"])]
    assert len(rows) == len(episode.t_s)
    stamps = [d.header.stamp.sec * 10**9 + d.header.stamp.nanosec for d in rows]
    np.testing.assert_allclose(np.array(stamps) - episode.start_ns, episode.t_s * 1e9, atol=1.0)
    np.testing.assert_allclose(
        [(d.position[0], d.velocity[0]) for d in rows],
        np.tile([-0.5, 0.25], (len(rows), 1)),
        atol=1e-12,
    )


def test_applied_commands_are_what_the_limits_leave_where_nobody_recorded_them():
    document = plant_document()
    (command,) = document["commands"]
    plant = Plant.from_document(document | {"commands": [command | {"limits": [-0.2, 0.5]}]})
    recorded = episode_bytes()
    episode = read_episode(recorded, plant.layout)
    written = BytesIO()
    write_overlay(written, recorded, episode, {}, regions_of_samples(plant, episode))
    reader = make_reader(BytesIO(written.getvalue()), decoder_factories=[DecoderFactory()])
    rows = [d for *_, d in reader.iter_decoded_messages(topics=["/trueup/applied"])]
    efforts = [d.effort[0] for d in rows]
    np.testing.assert_allclose(efforts, np.clip(episode.commands[:, 0], -0.2, 0.5))
    assert (min(efforts), max(efforts)) == (-0.2, 0.5)


def test_regions_are_told_whenever_they_change(made):
    import orjson

    plant, _, episode, written = made
    rows = [orjson.loads(data)["regions"] for _, data in messages(written, "/trueup/regions")]
    assert all(a != b for a, b in pairwise(rows))
    inside = regions_of_samples(plant, episode)
    assert rows[0] == [name for name, of in inside.items() if of[0]]
    assert {name for names in rows for name in names} == {
        name for name, of in inside.items() if of.any()
    }
