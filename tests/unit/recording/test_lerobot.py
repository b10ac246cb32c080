"""LeRobot datasets: each episode is a run, and the features' names are the joints'."""

import json

import numpy as np
import pytest

from tests.laws.test_formats import episode_of
from tests.support import recorded
from trueup.episode.layout import Field
from trueup.errors import BadEpisode, NotAnEpisode
from trueup.recording.asked import Asked
from trueup.recording.format import open_runs
from trueup.recording.guess import guess

RUNS = [recorded.simulated(200, seed) for seed in range(3)]


def test_every_episode_is_a_run_on_exact_frames(tmp_path):
    runs = open_runs(recorded.as_lerobot(RUNS, tmp_path / "so101"))
    assert [r.part for r in runs] == [f"so101/episode {i}" for i in range(3)]
    for run, made in zip(runs, RUNS, strict=True):
        episode = episode_of(run.recording)
        np.testing.assert_array_equal(np.round(episode.t_s * 1e9), 10_000_000 * np.arange(200))
        np.testing.assert_allclose(episode.observations[:, 0], made.q, atol=1e-6)
        np.testing.assert_allclose(episode.commands[:, 0], made.u, atol=1e-6)
        assert episode.layout.commands[0].field is Field.POSITION
        assert episode.layout.observations[0].joint == "elbow"


def test_of_several_joints_one_is_asked_for(tmp_path):
    folder = recorded.as_lerobot(RUNS[:1], tmp_path / "d", names=("elbow.pos",))
    info = json.loads((folder / "meta/info.json").read_text())
    for feature in info["features"].values():
        feature["names"] = {"motors": ["elbow.pos"]}
    (folder / "meta/info.json").write_text(json.dumps(info))
    mapping = guess(open_runs(folder)[0].recording, Asked(joint="elbow"))
    assert mapping.sources[0].signal == "observation.state[elbow.pos]"


def test_features_without_names_are_numbered(tmp_path):
    folder = recorded.as_lerobot(RUNS[:1], tmp_path / "d")
    info = json.loads((folder / "meta/info.json").read_text())
    for feature in info["features"].values():
        feature["names"] = None
    (folder / "meta/info.json").write_text(json.dumps(info))
    mapping = guess(open_runs(folder)[0].recording)
    assert [s.signal for s in mapping.sources] == ["observation.state[0]", "action[0]"]
    assert mapping.sources[0].guessed == ("signal", "unit")


def test_an_older_version_is_refused_with_what_converts_it(tmp_path):
    folder = recorded.as_lerobot(RUNS[:1], tmp_path / "d")
    info = json.loads((folder / "meta/info.json").read_text()) | {"codebase_version": "v2.1"}
    (folder / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(NotAnEpisode) as refused:
        open_runs(folder)
    assert "convert_dataset" in refused.value.hint


@pytest.mark.parametrize("spoil", ["meta/info.json", "data/chunk-000/file-000.parquet"])
def test_a_damaged_dataset_is_refused(tmp_path, spoil):
    folder = recorded.as_lerobot(RUNS, tmp_path / "d")
    rng = np.random.default_rng(3)
    whole, refusals = (folder / spoil).read_bytes(), 0
    for _ in range(30):
        spoilt = bytearray(whole)
        for at in rng.integers(0, len(whole), 4):
            spoilt[at] = int(rng.integers(256))
        (folder / spoil).write_bytes(spoilt)
        try:
            for run in open_runs(folder):
                episode_of(run.recording)
        except BadEpisode:
            refusals += 1
    assert refusals
