"""Drafts: received files propose a plant with its episodes, a person corrects it, and registers it.
Of hostile files nothing is read that was not sent."""

import io
import json
import uuid
import zipfile
from contextlib import closing

import numpy as np
import pytest

from tests.conftest import EXAMPLE
from tests.http.test_http import request
from tests.support.made import plant_document
from tests.support.service import ADMIN, ROOT
from trueup_client import Client
from trueup_service.drafts import MOST, Drafts, file_name
from trueup_service.errors import Conflict, NotFound

ARM = ROOT / "examples" / "so101"


def table(seed=0, head="t [s],pos [deg],torque [N·m]"):
    """A driven, damped joint as CSV, whose position is in degrees."""
    rng, rows, q, v = np.random.default_rng(seed), [], 0.0, 0.0
    for i in range(900):
        u = np.sin(0.013 * i) + 0.5 * np.sin(0.05 * i + seed)
        v += 0.01 * (8.0 * u - 1.5 * v - 12.0 * q)
        q += 0.01 * v
        rows.append(f"{0.01 * i:.4f},{np.degrees(q) + rng.normal(0.0, 0.02):.6f},{u:.6f}")
    return "\n".join([head, *rows]).encode()


def archive(files):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as packed:
        for name, content in files.items():
            packed.writestr(name, content)
    return data.getvalue()


def folder_of(path, *, without=()):
    return {p.name: p.read_bytes() for p in path.iterdir() if p.name not in without}


def propose(service, body, file, status=201, token=ADMIN):
    code, _, answer = request(
        service,
        "POST",
        f"/v1/drafts?file={file}",
        body,
        Authorization=f"Bearer {token}",
        Content_Type="application/octet-stream",
    )
    assert code == status, answer
    return json.loads(answer)


def send(service, draft, what, body=None, status=201, token=ADMIN):
    code, _, answer = request(
        service,
        "POST",
        f"/v1/drafts/{draft['digest']}/{what}",
        json.dumps(body or {}).encode(),
        Authorization=f"Bearer {token}",
        Content_Type="application/json",
    )
    assert code == status, answer
    return json.loads(answer)


def unique(stem):
    return f"{stem}{uuid.uuid4().hex[:8]}"


def test_a_table_proposes_a_plant_that_is_registered_with_its_episodes_and_a_gate(service, client):
    name = unique("axis")
    draft = propose(service, table(), f"{name}.csv")
    assert draft["problem"] is None
    assert draft["plant"]["name"] == draft["name"] == name
    assert [e["role"] for e in draft["episodes"]] == ["adaptation", "validation"]
    assert [c["unit"] for c in draft["plant"]["observations"]] == ["rad"]
    made = send(service, draft, "register", {"declare_gate": True})
    assert made["plant"]["document"]["nominal"] == draft["plant"]["nominal"]
    assert made["gate"]["document"]["rules"][0]["rule"] == "rollout_improves"
    listed = {e["digest"]: e for e in client.episodes(name)}
    assert set(listed) == {e["digest"] for e in made["episodes"]}
    recordings = {e["summary"]["conditions"]["recording"] for e in listed.values()}
    assert recordings == {f"{name}.csv"}
    again = send(service, draft, "register", {"declare_gate": True})  # as where an answer was lost
    assert again["plant"] == made["plant"]
    assert again["episodes"] == made["episodes"]


def test_what_was_found_is_corrected_before_it_is_registered(service, client):
    name = unique("b")
    draft = propose(service, table(), "axis.csv")
    wishes = {"name": name, "family": "oscillator", "units": {"q": "mrad"}, "stage": "SIL"}
    revised = send(service, draft, "revise", wishes, status=200)
    assert revised["digest"] == draft["digest"]
    assert revised["plant"]["name"] == name
    assert revised["plant"]["nominal"]["family"] == "oscillator"
    assert revised["mapping"]["observations"][0]["unit"] == "mrad"
    send(service, draft, "register")
    episode = next(iter(client.episodes(name)))
    assert episode["summary"]["conditions"]["stage"] == "SIL"


def test_where_names_do_not_tell_the_draft_lists_the_signals_to_choose_from(service):
    draft = propose(service, table(head="a,b,c"), "odd.csv")
    assert (draft["plant"], draft["signals"]) == (None, ["a", "b", "c"])
    assert draft["problem"]["code"] == "bad-mapping"
    refused = send(service, draft, "register", status=400)
    assert "which signals" in refused["hint"]
    wishes = {
        "signals": {"q": "b", "u": "c"},
        "units": {"q": "deg"},
        "time": "a",
        "time_unit": "s",
        "name": unique("c"),
    }
    revised = send(service, draft, "revise", wishes, status=200)
    assert revised["problem"] is None
    assert [s["signal"] for s in revised["mapping"]["observations"]] == ["b"]
    send(service, draft, "register")


def test_a_refused_wish_leaves_the_draft_as_it_is(service):
    draft = propose(service, table(), "axis.csv")
    assert send(service, draft, "revise", {"units": {"q": "kg"}}, status=200)["problem"] is not None
    send(service, draft, "revise", {"name": "Not a name"}, status=422)
    send(service, draft, "revise", {"plant": {"name": "x"}}, status=422)


def test_a_case_folder_is_registered_as_it_is(service, client):
    name = unique("emps")
    files = folder_of(EXAMPLE, without=("README.md", "gate.json"))
    document = {**json.loads(files["plant.json"]), "name": name}
    draft = propose(service, archive({**files, "plant.json": json.dumps(document)}), "emps.zip")
    assert draft["plant"] == document
    assert draft["is_role_declared"]
    send(service, draft, "register")
    sent = {p.name.split("-")[1].removesuffix(".mcap") for p in EXAMPLE.glob("*.mcap")}
    assert {e["role"] for e in client.episodes(name)} == sent


def test_a_plant_json_alone_is_registered_without_episodes(service, client):
    document = plant_document(unique("alone"))
    draft = propose(service, json.dumps(document).encode(), "plant.json")
    assert (draft["plant"], draft["episodes"]) == (document, [])
    assert send(service, draft, "register")["episodes"] == []
    assert client.plant(document["name"])["document"] == document


def test_a_robot_is_made_of_its_mjcf_and_its_recordings(service):
    name = unique("arm")
    files = folder_of(ARM, without=("plant.json", "README.md", "gate.json", "convert.py"))
    draft = propose(service, archive(files), f"{name}.zip")
    assert draft["plant"]["nominal"]["mjcf"] == "so101.xml"
    assert len(draft["plant"]["observations"]) == 6
    send(service, draft, "register")


def test_a_model_alone_is_refused_with_what_is_missing(service):
    refused = propose(service, (ARM / "so101.xml").read_bytes(), "so101.xml", status=422)
    assert "together with a recording" in refused["hint"]


@pytest.mark.parametrize("outside", ["/etc/passwd", "../../../../etc/passwd", "..\\..\\secret"])
def test_a_model_reads_no_file_that_was_not_sent(service, outside):
    model = (ARM / "so101.xml").read_text()
    model = model.replace("<worldbody>", f'<include file="{outside}"/><worldbody>', 1)
    files = folder_of(ARM, without=("plant.json", "README.md", "gate.json", "convert.py"))
    refused = propose(service, archive({**files, "so101.xml": model}), "arm.zip", status=422)
    assert "outside of what was received" in refused["detail"]
    assert "root:" not in json.dumps(refused)


def test_what_a_model_includes_reads_no_file_that_was_not_sent(service, tmp_path):
    secret = tmp_path / "secret.xml"
    secret.write_text("<mujoco/>")
    files = folder_of(ARM, without=("plant.json", "README.md", "gate.json", "convert.py"))
    model = files["so101.xml"].decode()
    for included, content in (
        ("b.xml", f'<mujoco><include file="{secret}"/></mujoco>'),
        ("b.txt", f'<mujoco><include file="{secret}"/></mujoco>'),
        ("b.xml", '<mujoco><asset><texture fileright="/etc/passwd"/></asset></mujoco>'),
        ("b.xml", '<mujoco><compiler meshdir="../.."/></mujoco>'),
    ):
        text = model.replace("<worldbody>", f'<include file="{included}"/><worldbody>', 1)
        sent = archive({**files, "so101.xml": text, included: content})
        refused = propose(service, sent, "arm.zip", status=422)
        assert refused["code"] == "bad-plant", refused
        assert "outside of what was received" in refused["detail"] or "no .xml" in refused["detail"]


@pytest.mark.parametrize("name", ["/etc/passwd", "../x.xml", "x" * 5000 + ".xml", "plant.json"])
def test_a_plant_json_names_a_model_of_its_own_folder_alone(service, name):
    document = json.loads((ARM / "plant.json").read_text())
    document["nominal"]["mjcf"] = name
    refused = propose(service, json.dumps(document).encode(), "plant.json", status=422)
    assert refused["facts"]["field"] == "nominal.mjcf"
    assert "mjcf must name" in refused["detail"]


def test_a_robot_comes_with_its_meshes(service):
    files = folder_of(ARM, without=("plant.json", "README.md", "gate.json", "convert.py"))
    mesh = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    asset = '<asset><mesh name="m" file="meshes/m.obj"/></asset><worldbody>'
    model = files["so101.xml"].decode().replace("<worldbody>", asset, 1)
    name = unique("mesh")
    sent = archive({**files, "so101.xml": model, "meshes/m.obj": mesh})
    draft = propose(service, sent, f"{name}.zip")
    assert draft["plant"]["nominal"]["mjcf"] == "so101.xml"
    send(service, draft, "register")


def test_what_was_sent_and_is_not_used_is_listed(service):
    files = {"a.csv": table(), "deeper/b.csv": table(seed=2), "gate.json": "{}", "README.md": "x"}
    assert propose(service, archive(files), "mixed.zip")["unused"] == ["deeper/b.csv", "gate.json"]


def test_several_models_are_refused_and_an_included_one_is_none(service):
    files = folder_of(ARM, without=("plant.json", "README.md", "gate.json", "convert.py"))
    refused = propose(service, archive({**files, "b.xml": "<mujoco/>"}), "arm.zip", status=422)
    assert "several models" in refused["detail"]
    text = files["so101.xml"].decode().replace("<worldbody>", '<include file="b.xml"/><worldbody>')
    included = '<mujoco><option timestep="0.002"/></mujoco>'
    sent = archive({**files, "so101.xml": text, "b.xml": included})
    assert propose(service, sent, "arm.zip")["plant"]["nominal"]["mjcf"] == "so101.xml"


def test_one_request_at_a_time_works_on_a_draft(tmp_path):
    drafts = Drafts(tmp_path)
    with drafts.alone("somebody", "0" * 64):
        with pytest.raises(Conflict), drafts.alone("somebody", "0" * 64):
            pass
        with drafts.alone("somebody else", "0" * 64):
            pass
    with drafts.alone("somebody", "0" * 64):
        pass


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("日本語.csv", "recording.csv"),
        ("机器人.json", "recording.json"),
        ("a b.tar.gz", "a-b.tar.gz"),
    ],
)
def test_a_name_keeps_its_end(name, kept):
    assert file_name(name) == kept


def test_an_archive_that_leads_out_is_refused(service):
    body = archive({"../../evil.csv": table()})
    assert propose(service, body, "x.zip", status=422)["code"] == "malformed-recording"


def test_a_taken_name_is_a_conflict_and_the_draft_stays(service, client):
    name = unique("taken")
    client.register_plant(plant_document(name))
    draft = propose(service, table(), f"{name}.csv")
    assert send(service, draft, "register", status=409)["code"] == "conflict"
    send(service, draft, "revise", {"name": unique("free")}, status=200)
    send(service, draft, "register")


def test_a_draft_is_seen_by_its_token_alone(service):
    with closing(Client(service.url)) as admin:
        other = admin.issue_token(unique("other"), ["engineer"])["token"]
    draft = propose(service, table(seed=3), "mine.csv")
    send(service, draft, "register", status=404, token=other)
    theirs = propose(service, table(seed=3), "mine.csv", token=other)
    assert theirs["digest"] == draft["digest"]
    send(service, theirs, "register", token=other, body={"declare_gate": False})
    send(service, draft, "revise", {"name": unique("d")}, status=200)


def test_a_token_of_one_plant_registers_none(service, client):
    name = unique("own")
    client.register_plant(plant_document(name))
    token = client.issue_token(unique("e"), ["engineer"], None, name)["token"]
    draft = propose(service, table(seed=5), "more.csv", token=token)
    assert send(service, draft, "register", status=403, token=token)["code"] == "forbidden"


@pytest.mark.parametrize(
    "name", ["../../etc/cron", "..", "a/b\\c.csv", ".hidden", "", "x" * 400, "\x00\n.csv", "é.csv"]
)
def test_a_file_keeps_a_name_that_is_safe(name):
    kept = file_name(name)
    assert kept
    assert kept.strip("./") == kept
    assert len(kept) <= 100
    assert "/" not in kept
    assert "\\" not in kept
    assert kept.isascii()
    assert kept.isprintable()


def test_the_oldest_drafts_make_room_and_abandoned_ones_go_by_their_age(tmp_path):
    drafts = Drafts(tmp_path)
    for i in range(MOST + 2):
        digest = f"{i:064x}"
        file = tmp_path / "sent"
        file.write_bytes(b"t")
        drafts.receive("somebody", digest, file, "log.csv")
        made = drafts.new_folder("somebody", digest)
        made.mkdir()
        drafts.keep("somebody", digest, {"plant": None}, made)
    left = [folder.name for folder in (tmp_path / "drafts").glob("*/*")]
    assert sorted(left) == [f"{i:064x}" for i in range(2, MOST + 2)]
    drafts.remove_old(0.0)
    assert not list((tmp_path / "drafts").glob("*/*"))
    with pytest.raises(NotFound):
        drafts.get("somebody", f"{MOST:064x}")
