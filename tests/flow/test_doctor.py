"""`trueup doctor` on a case folder: what it prints, what it writes, and that a diagnosis says the
same."""

import json
from pathlib import Path

import pytest

from tests.flow.test_diagnose import run
from tests.support.case import write_case
from tests.support.simulated import recorded_twice
from tests.support.spoilt import EVERYWHERE, WITH_VELOCITY
from trueup.diagnose.case import read_case


def spoilt_case(folder, what):
    plant, episodes, _ = recorded_twice("A1", ["coulomb_friction"], 11)
    spoil = {**EVERYWHERE, **WITH_VELOCITY}[what][1]
    folder.mkdir()
    write_case(folder, plant, spoil(plant, episodes))
    return folder


@pytest.fixture(scope="module")
def backward(tmp_path_factory):
    return spoilt_case(tmp_path_factory.mktemp("doctor") / "backward", "command sign")


def test_a_sound_case_has_no_findings():
    emps = Path(__file__).parents[2] / "examples" / "emps"
    document = json.loads(run("doctor", emps, "--json", "--strict").stdout)
    assert document["findings"] == []
    assert "Nothing is wrong with the" in run("doctor", emps).stdout


def test_a_spoilt_case_is_mended_into_another_folder(backward):
    document = json.loads(run("doctor", backward, "--json").stdout)
    assert [f["finding"] for f in document["findings"]] == ["command_sign"]
    assert set(document["findings"][0]["episodes"]) == {e["sha256"] for e in document["episodes"]}
    run("doctor", backward, "--strict", code=1)
    mended = backward.parent / "mended"
    run("doctor", backward, "--mend", mended)
    assert json.loads(run("doctor", mended, "--json").stdout)["findings"] == []
    (_, before), (_, after) = read_case(backward), read_case(mended)
    for was, became in zip(before, after, strict=True):
        assert (became.commands == -was.commands).all()
        assert became.conditions["mended_from"] == was.digest
        assert became.conditions["mends"] == "command_sign"
    records = json.loads((mended / "mends.json").read_text())["episodes"]
    assert [r["sha256"] for r in records] == [e.digest for e in before]
    assert run("doctor", backward, "--mend", mended, code=1).stderr


def test_a_diagnosis_tells_the_fault_first(backward):
    out = backward.parent / "out"
    done = run("diagnose", backward, "--out", out)
    report = json.loads((out / "report.json").read_text())
    assert [f["finding"] for f in report["findings"]] == ["command_sign"]
    assert done.stdout.startswith("Mend the log first: command sign of u.")
    assert "Mend the log first" in (out / "report.html").read_text()


def test_a_diagnosis_of_a_log_with_gaps_is_that_of_its_pieces(tmp_path):
    case, out = spoilt_case(tmp_path / "case", "a gap"), tmp_path / "out"
    run("diagnose", case, "--out", out)
    report = json.loads((out / "report.json").read_text())
    assert [e["effect"] for e in report["effects"]] == ["coulomb_friction"]
    assert {f["finding"] for f in report["findings"]} <= {"gap"}
    assert all(f["applied"] for f in report["findings"])
    digests = {e["sha256"] for e in report["evidence"]["episodes"]}
    assert {d for f in report["findings"] for d in f["episodes"]} <= digests
    assert all(len(d) == 64 for d in digests)
