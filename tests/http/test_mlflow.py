"""Versions go to an MLflow registry and come back the same; what is known there of a model that was
made elsewhere is in its provenance."""

import importlib
import json
import time
from contextlib import closing

import numpy as np
import onnxruntime
import pytest
import yaml

from tests.support.made import TRUE, episode_bytes, identified, plant_document, save
from tests.support.robots import arm_plant
from tests.unit.artifact.test_model import kept
from trueup.artifact import mlflow_model
from trueup.artifact.artifact import unpack
from trueup.artifact.mlflow_model import FILE, holds_artifact, write_mlflow_model
from trueup.episode.role import Role
from trueup.errors import BadArtifact, MlflowRefused, NotImportable, NotInstalled
from trueup.model.plant import Plant
from trueup.model.predictor import Identified
from trueup_cli import mlflow as passing
from trueup_client import Client, DigestMismatch, Problem

pytestmark = [
    pytest.mark.parametrize("service", ["embedded"], indirect=True),
    pytest.mark.filterwarnings("ignore"),  # of the other registry's own
]


@pytest.fixture(scope="module")
def registry(tmp_path_factory):
    return f"sqlite:///{tmp_path_factory.mktemp('mlflow')}/mlflow.db"


@pytest.fixture
def mlflow(registry, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # where it keeps files beside its database
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with passing._mlflow_at(registry) as module:
        yield module


@pytest.fixture
def plant(service):
    name = f"mlflow-{time.time_ns()}"
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document(name))
    return name


def printed(capsys):
    return json.loads(capsys.readouterr().out)


def judged(client, plant, tmp_path):
    """The decision on a version that is as the machine."""
    for seed, role in enumerate([Role.ADAPTATION, Role.VALIDATION]):
        client.upload_episode(plant, save(tmp_path, f"{role}.mcap", episode_bytes(seed, role=role)))
    candidate, gate = (
        client.add_artifact(plant, identified(plant, k=TRUE[0]).manifest)["digest"],
        client.declare_gate(plant)["digest"],
    )
    job = client.wait(
        client.submit(plant, {"kind": "gate", "candidate": candidate, "gate": gate})["id"]
    )
    return client.decision(plant, job["result"]["decision"])


def test_what_serves_goes_there_once_and_is_marked(
    service, client, mlflow, registry, plant, tmp_path, capsys
):
    decision = judged(client, plant, tmp_path)
    client.promote(plant, decision["digest"], 1)
    passing.export(plant, registry=registry, url=service.url, as_json_=True)
    assert printed(capsys) == {
        "model": f"models:/{plant}/1",
        "artifact": decision["candidate"],
        "serving": True,
    }
    there = mlflow.MlflowClient()
    version = there.get_model_version_by_alias(plant, "serving")
    run = there.get_run(version.run_id).data
    rule = decision["document"]["verdicts"][0]
    assert run.metrics[f"gate.{rule['rule']}.value"] == rule["value"]
    assert {k: float(run.params[k]) for k in "kcb"} == {"k": TRUE[0], "c": 0.6, "b": 0.8}
    assert version.tags == {
        "trueup.artifact": decision["candidate"],
        "trueup.plant": plant,
        "trueup.version": "2",
        "trueup.decision": decision["digest"],
        "trueup.accepted": "true",
    }
    passing.export(plant, registry=registry, url=service.url, as_json_=True)
    assert printed(capsys)["model"] == f"models:/{plant}/1"
    client.roll_back(plant, 2)
    passing.export(plant, registry=registry, url=service.url, as_json_=True)
    assert printed(capsys)["model"] == f"models:/{plant}/2"
    assert there.get_model_version_by_alias(plant, "serving").version == 2


def test_a_version_comes_back_as_it_went(service, client, mlflow, registry, plant, capsys):
    went = client.add_artifact(plant, identified(plant).manifest)["digest"]
    passing.export(
        plant, artifact=went, name=f"{plant}-elsewhere", registry=registry, url=service.url
    )
    assert f"{went} is models:/{plant}-elsewhere/1" in capsys.readouterr().out
    passing.import_(
        f"models:/{plant}-elsewhere/1", plant, registry=registry, url=service.url, as_json_=True
    )
    assert printed(capsys)["digest"] == went
    with pytest.raises(MlflowRefused, match="alias"):
        passing.import_(
            f"models:/{plant}-elsewhere@serving", plant, registry=registry, url=service.url
        )
    other = plant_document(f"{plant}-b")
    other["nominal"]["parameters"]["k"] = 9.0
    client.register_plant(other)
    with pytest.raises(Problem, match="another plant"):
        passing.import_(
            f"models:/{plant}-elsewhere/1", other["name"], registry=registry, url=service.url
        )


def logged(mlflow, folder, name, params):
    """A version that somebody else logged: a pickle, and a run with params."""
    there = mlflow.MlflowClient()
    experiment = there.get_experiment_by_name("elsewhere")
    run = there.create_run(
        experiment.experiment_id if experiment else there.create_experiment("elsewhere")
    ).info
    for key, x in params.items():
        there.log_param(run.run_id, key, x)
    there.log_metric(run.run_id, "rmse", 0.25)
    there.log_metric(run.run_id, "worst", float("inf"))
    folder.mkdir()
    (folder / FILE).write_text(
        "flavors:\n  sklearn: {pickled_model: m.pkl}\nutc_time_created: 2026-01-02 10:00:00\n"
    )
    there.log_artifacts(run.run_id, str(folder), "model")
    there.create_registered_model(name)
    there.create_model_version(
        name, f"{run.artifact_uri}/model", run.run_id, tags={"who": "</script>"}
    )
    return run.run_id


def test_a_model_from_elsewhere_becomes_a_candidate_that_says_so(
    service, client, mlflow, registry, plant, tmp_path, capsys
):
    run = logged(mlflow, tmp_path / "m", plant, {"k": "1.5", "c": 0.25, "b": 2, "solver": "lm"})
    passing.import_(f"models:/{plant}/1", plant, registry=registry, url=service.url, as_json_=True)
    version = printed(capsys)
    assert (version["kind"], version["job"], version["version"]) == ("identified", None, 2)
    manifest = json.loads(
        client.fetch(plant, version["digest"], tmp_path / "got")
        .joinpath("manifest.json")
        .read_text()
    )
    assert manifest["predictor"]["parameters"] == {"k": 1.5, "c": 0.25, "b": 2.0}
    assert manifest["provenance"]["origin"] == "mlflow"
    known = manifest["provenance"]["mlflow"]
    assert (known["source"], known["run"], known["registry"]) == (
        f"models:/{plant}/1",
        run,
        "sqlite",
    )
    assert (known["flavors"], known["created"], known["tags"]) == (
        ["sklearn"],
        "2026-01-02 10:00:00",
        {"who": "</script>"},
    )
    assert known["metrics"]["rmse"] == 0.25
    # this registry keeps an infinity as its largest number
    assert known["metrics"]["worst"] is None or known["metrics"]["worst"] > 1e300
    assert known["params"]["solver"] == "lm"


@pytest.mark.parametrize(
    ("b", "complaint"), [(None, "of its b"), ("x", "no numbers"), ("nan", "finite")]
)
def test_what_makes_no_predictor_of_the_plant_is_refused(
    service, client, mlflow, registry, plant, tmp_path, b, complaint
):
    logged(mlflow, tmp_path / "m", plant, {"k": 1, "c": 2, **({"b": b} if b else {})})
    with pytest.raises(NotImportable, match=complaint):
        passing.import_(f"models:/{plant}/1", plant, registry=registry, url=service.url)
    assert len(list(client.artifacts(plant))) == 1


@pytest.mark.parametrize(
    "text",
    [
        "- a\n- list\n",
        "{",
        None,
        "flavors: 7\n",
        "at: 2026-13-45\n",
        "2026-01-02: 3\n",
        "a: &x [*x]\n",
    ],
)
def test_folders_that_mlflow_did_not_write_are_refused(
    service, mlflow, registry, plant, tmp_path, text
):
    (tmp_path / "m").mkdir()
    if text is not None:
        (tmp_path / "m" / FILE).write_text(text)
    with pytest.raises(NotImportable):
        passing.import_(str(tmp_path / "m"), plant, registry=registry, url=service.url)


def test_what_names_no_version_or_no_registry_is_told(
    service, mlflow, registry, plant, monkeypatch
):
    with pytest.raises(NotImportable, match="names no version"):
        passing.import_("models:/x/latest", plant, registry=registry, url=service.url)
    with pytest.raises(MlflowRefused, match=r"http://127\.0\.0\.1:1: ") as refused:
        passing.export(plant, registry="http://ada:secret@127.0.0.1:1", url=service.url)
    assert "secret" not in str(refused.value)
    with pytest.raises(MlflowRefused, match="no registry"):
        passing.export(plant, url=service.url)
    monkeypatch.setattr(
        importlib, "import_module", lambda name: (_ for _ in ()).throw(ImportError(name))
    )
    with pytest.raises(NotInstalled) as refused:
        passing.export(plant, registry=registry, url=service.url)
    assert "trueup[mlflow]" in refused.value.hint


def test_an_artifact_becomes_a_folder_that_loads_by_either_flavor(service, mlflow, tmp_path):
    predictor = unpack(identified("p"))
    digest = kept(predictor, tmp_path / "m" / "artifact")
    write_mlflow_model(tmp_path / "m", "r", "2026-01-02T03:04:05.678901Z")
    flavors = yaml.safe_load((tmp_path / "m" / FILE).read_text())["flavors"]
    assert flavors["python_function"]["loader_module"] == mlflow_model.__name__
    loaded = mlflow_model._load_pyfunc(str(tmp_path / "m" / flavors["python_function"]["data"]))
    assert loaded.model.digest == digest
    t = np.arange(50) * 0.05
    table = {"t_s": t, "u": np.sin(t), "q": np.zeros(50), "v": np.zeros(50)}
    seen = loaded.predict(table)
    assert seen.shape == (50, 2)
    assert not np.array_equal(seen, loaded.predict(table, {"horizon_s": 0.5}))
    with pytest.raises(KeyError, match="v"):
        loaded.predict({"t_s": t, "u": t, "q": t})
    session = onnxruntime.InferenceSession(str(tmp_path / "m" / flavors["onnx"]["data"]))
    assert [x.name for x in session.get_inputs()] == ["state", "command"]
    document = json.loads((tmp_path / "m" / FILE).read_text())
    assert holds_artifact(document)
    assert [c["name"] for c in json.loads(document["signature"]["inputs"])] == [
        "t_s",
        "u",
        "q",
        "v",
    ]
    (tmp_path / "m" / "artifact" / "manifest.json").write_text("{}")
    with pytest.raises(BadArtifact):
        mlflow_model._load_pyfunc(str(tmp_path / "m" / "artifact"))


def test_what_was_changed_in_the_registry_is_not_taken_for_what_it_was(
    service, mlflow, registry, plant, tmp_path
):
    kept(unpack(identified(plant)), tmp_path / "m" / "artifact")
    write_mlflow_model(tmp_path / "m", None, "2026-01-02T03:04:05Z")
    kept(unpack(identified(plant, k=99.0)), tmp_path / "m" / "artifact")
    with pytest.raises(DigestMismatch, match="names artifact"):
        passing.import_(str(tmp_path / "m"), plant, url=service.url)
    (tmp_path / "m" / "artifact" / "manifest.json").unlink()
    with pytest.raises(NotImportable, match="there is none"):
        passing.import_(str(tmp_path / "m"), plant, url=service.url)


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("http://u:s3@h:5/x", "http://h:5"),
        ("postgresql://u:s/3@h/db", "postgresql"),
        ("postgresql://h/db?password=s3", "postgresql"),
        ("sqlite:///x@y.db", "sqlite"),
        ("/a/b", "file"),
    ],
)
def test_what_is_told_of_a_registry_holds_no_password(service, address, told):
    assert passing.without_credentials(address) == told


def test_names_that_differ_stay_different(service):
    names = ["a", "damping(à)", "damping(é)", "/arm/j1", "//arm/j1", "arm:j1"]
    assert len({passing.key(name) for name in names}) == len(names)
    assert passing.key("k_1.b-c") == "k_1.b-c"


def test_a_robot_loads_as_a_function_and_as_a_graph(service, tmp_path):
    plant = arm_plant(tmp_path)
    kept(Identified(plant, plant.parameters), tmp_path / "m" / "artifact")
    model = write_mlflow_model(tmp_path / "m", None, "2026-01-02T03:04:05Z")
    flavors = json.loads((tmp_path / "m" / FILE).read_text())["flavors"]
    assert set(flavors) == {"python_function", "onnx"}
    assert (tmp_path / "m" / "model.onnx").stat().st_size > 0
    assert set(passing.numbers(model)) == {
        passing.key(name) for name in Plant.from_document(plant.document).dynamics.parameter_names
    } | {"kind"}
