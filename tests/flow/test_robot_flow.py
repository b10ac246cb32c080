"""A robot given as MJCF takes the same way as every other plant: registered, fitted, judged,
served, fetched, predicted, rolled back."""

import csv
import json

import numpy as np
import pytest

from tests.support.case import write_recordings
from tests.support.robots import arm_plant, recorded
from tests.support.service import command
from trueup.episode.mcap import read_episode
from trueup.model.plant import Plant

ROLES = ("adaptation", "adaptation", "adaptation", "validation", "validation")


def carries(spec):
    spec.body("lower").add_geom(
        type=2, size=[0.03, 0, 0], pos=[0.3, 0, 0], mass=0.4, contype=0, conaffinity=0
    )


@pytest.fixture(scope="module")
def flow(service, tmp_path_factory):
    case = tmp_path_factory.mktemp("arm")
    plant = arm_plant(case)
    write_recordings(case, recorded(plant, carries, range(5), ROLES))

    def run(*arguments):
        return json.loads(command(service, *arguments, "--json").stdout)

    said = {
        "plant": run("plant", "register", str(case)),
        "episodes": run("upload", "arm", str(case)),
    }
    said["identified"] = run("fit", "arm")["result"]["artifact"]
    said["residual"] = run("fit", "arm", "--method", "residual")["result"]["artifact"]
    said["decision"] = run("gate", "arm", said["identified"])
    said["promoted"] = run("promote", "arm", said["decision"]["digest"])[0]
    said["serving"] = run("serving", "arm")[0]
    command(service, "fetch", "arm", str(case / "model"))
    arguments = (
        "--model",
        str(case / "model"),
        "--episode",
        str(case / "4-validation.mcap"),
        "--horizon",
        "0.5",
    )
    command(service, "predict", *arguments, "--out", str(case / "after.csv"))
    command(service, "predict", *arguments, "--out", str(case / "before.csv"), "--nominal")
    said["replay"] = run("replay", said["decision"]["digest"])
    said["rolled_back"] = run("rollback", "arm")[0]
    return said, case


def test_the_model_is_read_where_its_files_are_and_goes_along_as_numbers(flow):
    nominal = flow[0]["plant"]["document"]["nominal"]
    assert [j["name"] for j in nominal["tree"]["joints"]] == ["shoulder", "elbow"]
    assert nominal["left_out"] == []


def test_a_better_candidate_passes_its_gate_and_serves(flow):
    said, _ = flow
    assert said["decision"]["accepted"] is True
    assert said["serving"]["artifact"] == said["identified"]
    assert said["replay"]["agrees"] is True
    assert said["rolled_back"]["version"] == 1


def test_what_was_fetched_predicts_every_joint_better(flow):
    said, case = flow
    layout = Plant.from_document(said["plant"]["document"]).layout
    recorded = read_episode((case / "4-validation.mcap").read_bytes(), layout)

    def read(name):
        with (case / name).open() as file:
            rows = list(csv.reader(file))
        return rows[0], np.array(rows[1:], float)

    header, after = read("after.csv")
    before = read("before.csv")[1]
    assert header == ["t", "q_shoulder", "q_elbow", "v_shoulder", "v_elbow"]
    missed = [
        np.sqrt(np.mean((rows[:, 1:] - recorded.observations) ** 2, axis=0))
        for rows in (after, before)
    ]
    assert (missed[0] < 0.5 * missed[1]).all(), missed
