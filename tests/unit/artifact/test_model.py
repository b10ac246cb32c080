"""A loaded model predicts and rolls out, of one joint with numpy alone."""

import subprocess
import sys

import numpy as np
import pytest

import trueup
from tests.support.made import TRUE, episode_bytes, plant_document
from tests.support.robots import arm_plant
from tests.unit.model.test_step_function import PLANT, TOGETHER, commands, compiled, corrected
from trueup.artifact.artifact import pack
from trueup.episode.mcap import read_episode
from trueup.errors import BadArtifact
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal
from trueup.model.series import DECLARED


def kept(predictor, folder):
    artifact = pack(predictor, {"origin": "by hand"})
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "manifest.json").write_bytes(artifact.manifest)
    (folder / "arrays.safetensors").unlink(missing_ok=True)
    if artifact.arrays:
        (folder / "arrays.safetensors").write_bytes(artifact.arrays)
    return artifact.digest


def test_a_rollout_is_the_compiled_one_for_one_and_for_many(tmp_path):
    predictor, issued = corrected(TOGETHER, DECLARED), commands()
    digest = kept(predictor, tmp_path / "m")
    model = trueup.load(tmp_path / "m", digest)
    names = [c.name for c in model.observations]
    path = model.rollout(dict(zip(names, (0.3, -0.2), strict=True)), issued)
    assert np.abs(path - compiled(predictor, (0.3, -0.2), issued)).max() < 1e-9
    many = model.rollout({names[0]: 0.3, names[1]: -0.2}, np.stack([issued, commands(5)]))
    assert many.shape == (2, *path.shape)
    assert np.array_equal(many[0], path)
    assert not np.allclose(many[1], path, atol=1e-3)
    assert np.array_equal(model.rollout({names[0]: 0.3, names[1]: -0.2}, issued[:, 0]), path)
    assert (model.digest, model.period_s, model.commands[0].name) == (
        digest,
        PLANT.timestep_s,
        PLANT.layout.commands[0].name,
    )


def test_what_it_predicts_of_a_recording_is_what_the_machine_did(tmp_path):
    kept(Identified(PLANT, TRUE), tmp_path / "m")
    episode = read_episode(episode_bytes(), PLANT.layout)
    predicted = trueup.load(tmp_path / "m").predict(
        episode.t_s + 7.0, episode.commands, episode.observations, horizon_s=2.0
    )
    assert np.abs(predicted - episode.observations).max() < 1e-11
    kept(Nominal(PLANT), tmp_path / "m")
    off = trueup.load(tmp_path / "m").predict(
        episode.t_s, episode.commands[:, 0], episode.observations
    )
    assert np.abs(off - episode.observations).max() > 1e-2


def test_a_robot_rolls_out(tmp_path):
    plant = arm_plant(tmp_path)
    kept(Nominal(plant), tmp_path / "m")
    model = trueup.load(tmp_path / "m")
    path = model.rollout({}, np.zeros((50, 2)))
    assert path.shape == (50, len(model.observations))
    assert path[0] == pytest.approx(0.0)
    assert np.abs(path[-1]).max() > 0.1  # it falls
    states = np.zeros((1, 4))
    assert np.allclose(
        path[1],
        plant.observe(Nominal(plant).predict_batch(states, np.zeros((1, 2))))[0],
        atol=1e-12,
    )
    with pytest.raises(ValueError, match=r"\(samples, 2\)"):
        model.rollout({}, np.zeros(50))


def test_what_does_not_fit_is_told(tmp_path):
    digest = kept(Nominal(PLANT), tmp_path / "m")
    model = trueup.load(tmp_path / "m")
    with pytest.raises(ValueError, match="there is no observation 'speed': this model has"):
        model.rollout({"speed": 1.0}, np.zeros(3))
    with pytest.raises(ValueError, match="commands are"):
        model.rollout({}, np.zeros((3, 2)))
    with pytest.raises(BadArtifact, match=r"no manifest\.json"):
        trueup.load(tmp_path)
    with pytest.raises(BadArtifact, match="not the one"):
        trueup.load(tmp_path / "m", digest[::-1])
    with pytest.raises(AttributeError):
        trueup.nothing  # noqa: B018


def test_one_joint_is_computed_by_numpy_alone(tmp_path):
    kept(corrected(TOGETHER, DECLARED), tmp_path / "m")
    said = (
        f"import sys, trueup; m = trueup.load({str(tmp_path / 'm')!r}); m.rollout({{}}, [0.1] * 9);"
        "print(*sorted({n.partition('.')[0] for n in sys.modules} - {*sys.stdlib_module_names}))"
    )
    command = [sys.executable, "-I", "-c", said]  # as a robot's own script, in no folder of ours
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    others = {name for name in done.stdout.split() if not name.startswith("_")}
    # and what reads the artifact
    assert others == {"numpy", "trueup", "orjson", "rfc8785", "safetensors"}


def test_a_robot_of_one_joint_rolls_out(tmp_path):
    (tmp_path / "one.xml").write_text(
        '<mujoco><worldbody><body><joint name="j" type="slide" axis="1 0 0" '
        'damping="0.5"/><geom size="0.1" mass="2"/></body></worldbody>'
        '<actuator><motor joint="j"/></actuator></mujoco>'
    )
    channels = {
        "commands": [{"name": "u", "joint": "j", "unit": "N", "limits": [-1, 1]}],
        "observations": [{"name": "q", "joint": "j", "field": "position", "unit": "m"}],
    }
    document = {
        "name": "one",
        "nominal": {"mjcf": "one.xml", "timestep_s": 0.01},
        "evaluation": {"horizon_s": 0.5},
        **channels,
    }
    plant = Plant.from_document(resolved(document, tmp_path))
    kept(Nominal(plant), tmp_path / "m")
    path = trueup.load(tmp_path / "m").rollout({"q": 0.2}, np.full(50, 3.0))
    assert path[0, 0] == 0.2
    assert np.allclose(
        path, plant.observe(Nominal(plant).run(np.array([0.2, 0.0]), np.full((50, 1), 3.0)))
    )


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"t_s": [0.0, 0.1, 0.1]}, "each after the one before"),
        ({"t_s": [0.0, np.nan, 0.2]}, "finite"),
        ({"observed": np.zeros((2, 3))}, r"observed are \(3, 2\)"),
        ({"commands": np.zeros(4)}, r"commands are \(3, 1\)"),
        ({"horizon_s": -1.0}, "positive"),
    ],
)
def test_a_recording_that_does_not_fit_is_refused(tmp_path, wrong, complaint):
    kept(Nominal(Plant.from_document(plant_document())), tmp_path / "m")
    given = {
        "t_s": [0.0, 0.05, 0.1],
        "commands": np.zeros(3),
        "observed": np.zeros((3, 2)),
        **wrong,
    }
    with pytest.raises(ValueError, match=complaint):
        trueup.load(tmp_path / "m").predict(**given)
    with pytest.raises(ValueError, match="commands are"):
        trueup.load(tmp_path / "m").rollout({}, np.zeros((0, 1)))
