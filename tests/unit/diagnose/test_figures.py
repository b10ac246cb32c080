"""The numbers behind pictures say what they show: means of cells, errors of models, two versions
side by side."""

import numpy as np
import pytest

from tests.support.made import TRUE, episode_bytes, plant_document
from trueup.canonical import canonical_bytes
from trueup.diagnose.maps import Places, maps
from trueup.diagnose.side_by_side import side_by_side
from trueup.diagnose.traces import traces
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.fit.score import rollout_rms
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal

PLANT = Plant.from_document(plant_document())


@pytest.fixture(scope="module")
def episodes():
    return [
        read_episode(episode_bytes(seed, role=Role.VALIDATION), PLANT.layout) for seed in (1, 2)
    ]


def test_a_cell_is_the_mean_of_what_fell_into_it():
    n = 4000
    rng = np.random.default_rng(0)
    speed, command, time = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n), rng.uniform(0, 10, n)
    drawn = maps({"nominal": np.sign(speed)}, Places(PLANT, 0, speed, command, time))
    cells = np.array(drawn["layers"]["nominal"]["speed-command"], float)
    assert cells.shape == (16, 16)
    np.testing.assert_allclose(cells[:, :7], -1.0)
    np.testing.assert_allclose(cells[:, 9:], 1.0)
    assert drawn["scale"] == 1.0
    assert drawn["axes"]["speed"]["unit"] == "m/s"
    assert drawn["axes"]["command"]["unit"] == "m/s^2"


def test_a_cell_into_which_nothing_fell_is_empty():
    speed = np.concatenate([np.full(50, -1.0), np.full(50, 1.0)])
    drawn = maps({"nominal": speed}, Places(PLANT, 0, speed, speed, np.linspace(0, 1, 100)))
    cells = drawn["layers"]["nominal"]["speed-command"]
    assert cells[0][0] == -1.0
    assert cells[-1][-1] == 1.0
    assert cells[0][-1] is None


def test_traces_hold_what_was_measured_and_each_models_error(episodes):
    models = {"nominal": Nominal(PLANT), "true": Identified(PLANT, TRUE)}
    (drawn,) = traces(PLANT, episodes[:1], models, list(enumerate(PLANT.layout.observations)))
    q = drawn["channels"][0]
    np.testing.assert_allclose(q["measured"], episodes[0].observations[:, 0], rtol=1e-4, atol=1e-9)
    assert q["rms"]["true"] < 1e-9
    assert q["rms"]["nominal"] == pytest.approx(
        rollout_rms(models["nominal"], episodes[0], PLANT.horizon_s)[0], rel=0.05
    )
    assert q["envelope"] == [-0.9, 0.9]
    assert len(drawn["t_s"]) == len(q["nominal"]) == 200


def test_the_true_model_is_better_everywhere(episodes):
    found = side_by_side(Nominal(PLANT), Identified(PLANT, TRUE), episodes)
    canonical_bytes(found)  # it can be kept, and named by its digest
    assert len(found["maps"]) == 2  # one for each channel
    for of in found["maps"]:
        assert of["rms"]["second"] < 1e-9 < of["rms"]["first"]
        cells = np.array(of["layers"]["worse"]["speed-command"], float)
        assert np.nanmax(cells) <= 1e-9
    assert [e["sha256"] for e in found["by_episode"]] == [e.digest for e in episodes]
    assert all(
        e["channels"]["q"]["second"] < e["channels"]["q"]["first"] for e in found["by_episode"]
    )


def test_a_model_beside_itself_is_nowhere_better_or_worse(episodes):
    found = side_by_side(Nominal(PLANT), Nominal(PLANT), episodes)
    assert [of["scale"] for of in found["maps"]] == [0.0, 0.0]
