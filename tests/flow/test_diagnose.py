"""`trueup diagnose` on a case folder, then `trueup predict` with what it wrote."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.case import write_case, write_recording
from tests.support.simulated import episode_of
from tests.support.simulated import recorded_twice as recorded
from trueup.episode.role import Role

TRUEUP = Path(sys.executable).parent / "trueup"


def run(*arguments, code=0):
    done = subprocess.run(
        [TRUEUP, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("case")
    plant, episodes, trial = recorded("A1", ["coulomb_friction"], 11)
    write_case(folder, plant, episodes)
    out = folder / "out"
    return folder, out, run("diagnose", folder, "--out", out), plant, trial


def test_it_writes_a_report_a_page_and_a_model(case):
    _, out, done, _, _ = case
    report = json.loads((out / "report.json").read_text())
    assert report["schema"] == "trueup.diagnosis/1"
    assert [e["effect"] for e in report["effects"]] == ["coulomb_friction"]
    assert (out / "report.html").read_text().startswith("<!doctype html>")
    assert "Coulomb friction" in done.stdout
    assert len(report["evidence"]["episodes"]) == 4


def test_its_model_predicts_an_episode_that_it_never_saw(case):
    folder, out, _, plant, trial = case
    test = trial.of("test")[0]
    episode = write_recording(folder / "test.mcap", episode_of(plant, test, Role.TEST, "test"))
    missed = {}
    for which, extra in (("nominal", ["--nominal"]), ("corrected", [])):
        table = folder / f"{which}.csv"
        run(
            "predict",
            "--model",
            out / "model",
            "--episode",
            episode,
            "--horizon",
            2.0,
            "--out",
            table,
            *extra,
        )
        with table.open() as file:
            rows = np.array([[float(x) for x in row] for row in list(csv.reader(file))[1:]])
        assert np.allclose(rows[:, 0], test.t_s, atol=1e-8)
        missed[which] = float(np.sqrt(np.mean((rows[:, 1:] - test.observed) ** 2)))
    assert missed["corrected"] < 0.2 * missed["nominal"]


def test_a_prediction_has_what_was_measured_beside_it_and_says_what_is_not_scored(case):
    folder, out, _, plant, trial = case
    run_ = trial.of("test")[0]
    episode = write_recording(folder / "beside.mcap", episode_of(plant, run_, Role.TEST, "test"))
    model, table = ["--model", out / "model", "--episode", episode], folder / "beside.csv"
    done = run("predict", *model, "--horizon", 2.0, "--out", table, "--measured", "--json")
    with table.open() as file:
        head, *rows = list(csv.reader(file))
    assert head == ["t", "q", "v", "measured_q", "measured_v"]
    values = np.array(rows, float)
    assert np.allclose(values[:, 3:], run_.observed, atol=1e-12)
    printed = json.loads(done.stdout)
    starts = np.flatnonzero(np.diff(np.floor(values[:, 0] / 2.0 + 1e-9), prepend=-1.0))
    scored = np.setdiff1d(np.arange(len(values)), starts)
    rms = np.sqrt(np.mean((values[scored, 1] - values[scored, 3]) ** 2))
    assert printed["rms"]["q"] == pytest.approx(rms, rel=0.05)  # a window ends on the next start
    assert printed["gate"]["windows"] == len(starts) - 1  # the last sample ends the one before
    assert printed["left_out"] == []


def test_a_folder_without_a_plant_says_what_a_case_is(tmp_path):
    done = run("diagnose", tmp_path, "--out", tmp_path / "out", code=1)
    assert "plant.json" in done.stderr


def test_a_blind_trial_of_a_case_can_be_held_against_its_log(case, tmp_path):
    folder, *_ = case
    out = tmp_path / "trial"
    assert "effects hidden" in run("blindtrial", folder, "--out", out, "--trials", 2).stdout
    assert sorted(p.name for p in out.iterdir()) == [
        "audit.jsonl",
        "cases",
        "report.html",
        "report.json",
    ]
    assert "2 labels are those committed" in run("blindtrial", out, "--verify").stdout
    assert "not-empty" in run("blindtrial", folder, "--out", out, code=1).stderr
    report = json.loads((out / "report.json").read_text())
    (tmp_path / "secret").write_text(report["opening"]["secret"])
    run(
        "blindtrial",
        folder,
        "--out",
        tmp_path / "again",
        "--trials",
        2,
        "--secret-file",
        tmp_path / "secret",
    )
    again = json.loads((tmp_path / "again" / "report.json").read_text())
    assert [r["commitment"] for r in again["rows"]] == [r["commitment"] for r in report["rows"]]
    assert again["opening"]["redrawn"]
    report["rows"][0]["label"]["effects"] = {"cogging": {"amplitude": 1.0}}
    (out / "report.json").write_text(json.dumps(report))
    assert "not-as-committed" in run("blindtrial", out, "--verify", code=1).stderr
    (tmp_path / "secret").write_text("no secret")
    assert (
        "no-secret"
        in run(
            "blindtrial",
            folder,
            "--out",
            tmp_path / "third",
            "--secret-file",
            tmp_path / "secret",
            code=1,
        ).stderr
    )
