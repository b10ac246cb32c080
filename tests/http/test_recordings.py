"""Recordings of any format over HTTP: each becomes an episode that names what it was made from, and
what is malformed, huge or ambiguous is refused."""

import hashlib
import json
import shutil
import uuid

import numpy as np
import pytest

from tests.http.test_http import problem, request
from tests.laws.test_formats import FILES, WRITERS
from tests.support import recorded
from tests.support.made import plant_document
from trueup_client import Problem

RUN = recorded.simulated(300)
MEDIA_TYPES = {
    "csv": "text/csv",
    "npz": "application/x-npz",
    "parquet": "application/vnd.apache.parquet",
    "hdf5": "application/x-hdf5",
    "rosbag2": "application/vnd.sqlite3",
    "rosbag1": "application/x-rosbag",
    "mcap": "application/mcap",
}


@pytest.fixture
def plant(client):
    """A plant of one unnamed joint in rad and N·m."""
    name = f"p{uuid.uuid4().hex[:12]}"
    document = plant_document(name)
    for channel, unit in zip(
        (*document["observations"], *document["commands"]), ("rad", "rad/s", "N·m"), strict=True
    ):
        channel["unit"] = unit
    client.register_plant(document)
    return name


@pytest.mark.parametrize("name", FILES)
def test_every_format_becomes_the_same_episode(client, plant, tmp_path, name):
    path = WRITERS[name](RUN, tmp_path)
    episode = client.upload_episode(
        plant, path, role="adaptation", conditions={"stage": "SIL", "payload": "none"}
    )
    summary, source = episode["summary"], episode["summary"]["source"]
    assert (episode["role"], summary["samples"]) == ("adaptation", 300)
    assert summary["conditions"] == {"stage": "SIL", "payload": "none"}
    assert (source["format"], source["file"]) == (name, path.name)
    assert source["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    again = client.upload_episode(
        plant, path, role="adaptation", conditions={"stage": "SIL", "payload": "none"}
    )
    assert again["digest"] == episode["digest"]
    client.download_episode(plant, episode["digest"], tmp_path / "back.mcap")
    data = (tmp_path / "back.mcap").read_bytes()
    assert hashlib.sha256(data).hexdigest() == episode["digest"]
    ingested = [e for e in client.audit(plant=plant) if e["kind"] == "episode:ingested"]
    assert ingested[0]["facts"]["source"]["sha256"] == source["sha256"]


@pytest.mark.parametrize("name", FILES)
def test_the_content_tells_the_format_where_the_type_does_not(service, plant, tmp_path, name):
    body = WRITERS[name](RUN, tmp_path).read_bytes()
    status, _, content = request(
        service, "POST", f"/v1/plants/{plant}/episodes?role=validation", body
    )
    assert status == 201, content
    assert json.loads(content)["summary"]["source"]["format"] == name


@pytest.mark.parametrize("name", FILES)
def test_malformed_files_of_each_format_are_refused(service, plant, tmp_path, name):
    whole = WRITERS[name](RUN, tmp_path).read_bytes()
    rng = np.random.default_rng(4)
    statuses = set()
    for attempt in range(12):
        spoilt = bytearray(whole)
        if attempt % 2:
            del spoilt[int(rng.integers(20, len(whole) - 1)) :]
        else:
            for at in rng.integers(0, len(whole), 3 * attempt + 1):
                spoilt[at] = int(rng.integers(256))
        status, answered, content = request(
            service,
            "POST",
            f"/v1/plants/{plant}/episodes?role=validation",
            bytes(spoilt),
            Content_Type=MEDIA_TYPES[name],
        )
        statuses.add(status)
        assert status in (200, 201, 422, 413), content
        if status == 422:
            assert answered["content-type"] == "application/problem+json"
            assert json.loads(content)["hint"]
    assert 422 in statuses


def test_a_file_that_says_nothing_of_its_role_is_asked_for_it(service, plant, tmp_path):
    body = recorded.as_csv(RUN, tmp_path / "run.csv").read_bytes()
    status, code, document = problem(
        service, "POST", f"/v1/plants/{plant}/episodes", body, Content_Type="text/csv"
    )
    assert (status, code, document["facts"]["rule"]) == (422, "not-an-episode", "role")
    assert "adaptation" in document["hint"]


def test_what_is_guessed_is_sent_back_and_taken_once_it_is_confirmed(client, plant, tmp_path):
    path = recorded.as_csv(RUN, tmp_path / "run.csv", ["t", "pos", "vel", "target_pos"])
    lines = path.read_text().splitlines()
    more = [f"{line},{line.split(',')[1]}" for line in lines[1:]]
    path.write_text("\n".join([f"{lines[0]},measured_pos", *more]) + "\n")
    with pytest.raises(Problem) as refused:
        client.upload_episode(plant, path, role="adaptation")
    assert refused.value.code == "bad-mapping"
    mapping = json.loads(refused.value.facts["mapping"])
    assert mapping["observations"][0]["signal"] == "measured_pos"
    assert mapping["observations"][0]["guessed"] == ["signal", "unit"]
    mapping["commands"][0] = {"field": "effort", "signal": "target_pos"}
    episode = client.upload_episode(plant, path, role="adaptation", mapping=mapping)
    assert episode["summary"]["samples"] == 300
    kept = json.loads(episode["summary"]["source"]["mapping"])
    assert kept["commands"][0]["signal"] == "target_pos"


def test_units_that_cannot_be_converted_are_refused(client, plant, tmp_path):
    path = recorded.as_csv(RUN, tmp_path / "run.csv", ["t_s", "q_mm", "v_mm_s", "u_nm"])
    with pytest.raises(Problem, match="mm, and q is declared in rad"):
        client.upload_episode(plant, path, role="adaptation")


def test_a_dataset_comes_as_a_zip_and_each_part_is_named(client, tmp_path):
    name = f"p{uuid.uuid4().hex[:12]}"
    document = plant_document(name)
    document["observations"] = [{"name": "q", "unit": "rad", "joint": "elbow"}]
    document["commands"] = [
        {"name": "u", "unit": "rad", "joint": "elbow", "field": "position", "limits": [-1, 1]}
    ]
    del document["envelope"]
    client.register_plant(document)
    runs = [recorded.simulated(200, seed) for seed in range(2)]
    folder = recorded.as_lerobot(runs, tmp_path / "so101")
    archive = shutil.make_archive(str(tmp_path / "so101"), "zip", tmp_path, "so101")
    with pytest.raises(Problem) as refused:
        client.upload_episode(name, archive, role="adaptation")
    assert refused.value.facts["parts"] == ["episode 0", "episode 1"]
    episode = client.upload_episode(name, archive, role="adaptation", part="episode 1")
    assert episode["summary"]["samples"] == 200
    assert episode["summary"]["source"]["part"] == "episode 1"
    assert folder.is_dir()


def test_a_zip_that_reaches_outside_its_folder_is_refused(service, plant, tmp_path):
    import io
    import zipfile

    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("../escaped.csv", "time_s,q_rad,u_nm\n0,1,2\n0.1,1,2\n")
    status, code, _ = problem(
        service,
        "POST",
        f"/v1/plants/{plant}/episodes?role=validation",
        stream.getvalue(),
        Content_Type="application/zip",
    )
    assert (status, code) == (422, "malformed-recording")


def test_a_long_table_goes_in_parts(client, plant, tmp_path, monkeypatch):
    monkeypatch.setattr("trueup_client.calls.plants.RESUMABLE_FROM_BYTES", 1000)
    path = recorded.as_csv(RUN, tmp_path / "run.csv")
    episode = client.upload_episode(plant, path, role="validation")
    assert episode["summary"]["source"]["file"] == "run.csv"
