"""From recordings that say nothing of themselves to a case folder: what is found, what is assumed,
what is asked."""

import json

import numpy as np
import pytest

from tests.support import recorded
from tests.support.made import T0_NS, TRUE, arm_layout, plant_document
from tests.support.robots import ARM
from trueup.diagnose.case import read_case
from trueup.episode.layout import Channel, Field, Layout
from trueup.episode.role import Role
from trueup.episode.writer import Encoding, write_episode
from trueup.errors import BadMapping, BadPlant, NotAnEpisode, NotIdentifiable
from trueup.model.plant import Plant
from trueup.recording.format import open_runs
from trueup_cli.init import CaseOptions, case_of

PLANT = Plant.from_document(plant_document())
LAYOUT = Layout(
    (Channel("q", "rad", Field.POSITION, "hinge"), Channel("v", "rad/s", Field.VELOCITY, "hinge")),
    (Channel("u", "N·m", Field.EFFORT, "hinge"),),
    "/robot/joint_states",
    "/robot/effort_command",
)


NAMED = Layout(
    tuple(
        Channel(f"{symbol}_{joint}", unit, field, joint)
        for symbol, unit, field in (
            ("q", "rad", Field.POSITION),
            ("v", "rad/s", Field.VELOCITY),
        )
        for joint in ("shoulder", "elbow")
    ),
    tuple(Channel(f"u_{joint}", "N·m", Field.EFFORT, joint) for joint in ("shoulder", "elbow")),
)


def moved(seed, samples=600):
    """States and commands of an excited oscillator."""
    rng = np.random.default_rng(seed)
    issued = np.clip(np.convolve(rng.normal(size=samples), np.ones(8) / 4, "same"), -0.87, 0.87)[
        :, None
    ]
    issued[7] = 0.87
    states = np.zeros((samples, 2))
    for i in range(samples - 1):
        states[i + 1] = PLANT.update(states[i : i + 1], issued[i : i + 1], TRUE)[0]
    return states + rng.normal(scale=1e-4, size=states.shape), issued


def record(
    path, seed, *, role=None, layout=LAYOUT, encoding=Encoding.CDR, states=None, issued=None
):
    """A recording as `ros2 bag` leaves it: no role, no conditions."""
    made = moved(seed)
    states, issued = made[0] if states is None else states, made[1] if issued is None else issued
    stamps = T0_NS + 10**12 * seed + np.arange(len(states)) * 50_000_000
    with path.open("wb") as file:
        write_episode(
            file,
            stamps_ns=stamps,
            observations=states,
            commands=issued,
            layout=layout,
            role=role,
            conditions={},
            encoding=encoding,
        )
    return path


def make_case(log, out, options):
    return case_of(log, out, options, is_quiet=True)


@pytest.mark.parametrize("encoding", Encoding)
def test_the_signals_of_a_log_are_seen_in_every_encoding(tmp_path, encoding):
    (run,) = open_runs(record(tmp_path / "bag.mcap", 0, encoding=encoding))
    streams = {s.name: s for s in run.recording.streams}
    assert set(streams) == {"/robot/joint_states", "/robot/effort_command"}
    states = streams["/robot/joint_states"].signals
    assert {(s.name, s.joint, s.field) for s in states} == {
        ("hinge/position", "hinge", Field.POSITION),
        ("hinge/velocity", "hinge", Field.VELOCITY),
    }
    (command,) = streams["/robot/effort_command"].signals
    assert (command.joint, command.field) == ("hinge", Field.EFFORT)
    span = run.recording.span("/robot/joint_states", None)
    assert (span.last_ns - span.first_ns) / 599 == pytest.approx(5e7)
    assert (span.rows, run.recording.role) == (600, None)


def test_a_bag_of_several_files_becomes_a_case(tmp_path):
    bag = tmp_path / "My Bag 3"
    bag.mkdir()
    for seed in range(4):
        record(bag / f"bag_{seed}.mcap", seed)
    make_case(bag, tmp_path / "case", CaseOptions())
    document = json.loads((tmp_path / "case" / "plant.json").read_text())
    assert document["name"] == "my-bag-3"
    assert document["topics"] == {
        "observation": "/robot/joint_states",
        "command": "/robot/effort_command",
    }
    assert document["commands"][0]["limits"] == [-0.87, 0.87]
    assert document["nominal"]["timestep_s"] == 0.05
    assert document["nominal"]["family"] == "oscillator"
    assert list(document["nominal"]["parameters"].values()) == pytest.approx(TRUE, rel=0.02)
    _, episodes = read_case(tmp_path / "case")
    assert sorted(str(e.role) for e in episodes) == [
        "adaptation",
        "adaptation",
        "adaptation",
        "validation",
    ]
    assert {e.conditions["stage"] for e in episodes} == {"physical"}


def test_the_end_of_a_single_file_is_held_out_and_nothing_is_in_both(tmp_path):
    make_case(record(tmp_path / "bag.mcap", 1), tmp_path / "case", CaseOptions())
    _, (first, second) = read_case(tmp_path / "case")
    assert (first.role, second.role) == (Role.ADAPTATION, Role.VALIDATION)
    assert first.start_ns + round(first.t_s[-1] * 1e9) < second.start_ns
    assert len(first.t_s) + len(second.t_s) == 600
    assert len(second.t_s) == pytest.approx(180, abs=2)


def test_roles_that_files_declare_are_kept_byte_by_byte(tmp_path):
    paths = [
        record(tmp_path / f"{i}.mcap", i, role=role)
        for i, role in enumerate((Role.VALIDATION, Role.ADAPTATION))
    ]
    make_case(tmp_path, tmp_path / "case", CaseOptions())
    kept = {
        p.name.split("-")[1].removesuffix(".mcap"): p.read_bytes()
        for p in (tmp_path / "case").glob("*.mcap")
    }
    assert kept == {"validation": paths[0].read_bytes(), "adaptation": paths[1].read_bytes()}


def test_a_family_may_be_given_and_an_unknown_one_is_refused(tmp_path):
    path = record(tmp_path / "bag.mcap", 2)
    make_case(path, tmp_path / "case", CaseOptions(family="pendulum"))
    assert (
        json.loads((tmp_path / "case" / "plant.json").read_text())["nominal"]["family"]
        == "pendulum"
    )
    with pytest.raises(BadPlant, match="no family") as refused:
        make_case(path, tmp_path / "other", CaseOptions(family="rocket"))
    assert "inertia" in refused.value.hint


def test_several_joints_are_asked_about(tmp_path):
    states, issued = moved(3)
    both = {
        "states": np.hstack([states[:, :1], states[:, :1], states[:, 1:], states[:, 1:]]),
        "issued": np.hstack([issued, issued]),
    }
    path = record(tmp_path / "arm.mcap", 3, layout=arm_layout(2), **both)
    with pytest.raises(BadMapping, match="2 joints") as refused:
        make_case(path, tmp_path / "case", CaseOptions())
    assert "j0, j1" in refused.value.hint
    make_case(path, tmp_path / "case", CaseOptions(joint="j1"))
    assert (
        json.loads((tmp_path / "case" / "plant.json").read_text())["observations"][0]["joint"]
        == "j1"
    )


def test_what_cannot_be_found_is_named_with_what_there_is(tmp_path):
    path = record(tmp_path / "bag.mcap", 4)
    with pytest.raises(BadMapping) as refused:
        make_case(path, tmp_path / "case", CaseOptions(observation="/nothing"))
    assert "/robot/joint_states" in refused.value.hint
    (tmp_path / "empty").mkdir()
    with pytest.raises(NotAnEpisode) as refused:
        make_case(tmp_path / "empty", tmp_path / "other", CaseOptions())
    assert "docs/recordings.md" in refused.value.hint


def test_a_command_that_never_moves_is_refused(tmp_path):
    path = record(tmp_path / "bag.mcap", 5, issued=np.zeros((600, 1)))
    with pytest.raises(NotIdentifiable, match="0 throughout"):
        make_case(path, tmp_path / "case", CaseOptions())


def test_a_joint_that_is_commanded_by_positions_is_an_oscillator_about_its_command(tmp_path):
    folder = recorded.as_lerobot([recorded.simulated(400, s) for s in range(3)], tmp_path / "d")
    made = make_case(folder, tmp_path / "case", CaseOptions())
    nominal = made.document["nominal"]
    assert nominal["family"] == "oscillator"
    assert nominal["parameters"]["b"] == pytest.approx(nominal["parameters"]["k"], rel=0.3)


def test_a_model_beside_the_recordings_is_taken(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    states, issued = moved(6)
    both = {
        "states": np.hstack([states[:, :1], states[:, :1], states[:, 1:], states[:, 1:]]),
        "issued": np.hstack([issued, issued]),
    }
    record(tmp_path / "run.mcap", 6, layout=NAMED, **both)
    made = make_case(tmp_path, tmp_path / "case", CaseOptions())
    assert made.document["nominal"]["mjcf"] == "arm.xml"
    assert (tmp_path / "case" / "arm.xml").is_file()
    assert [c["joint"] for c in made.document["commands"]] == ["shoulder", "elbow"]


def test_a_mapping_is_used_again(tmp_path):
    path = recorded.as_csv(recorded.simulated(400), tmp_path / "a.csv", ["t", "x", "y", "z"])
    asked = {"q": "x", "v": "y", "u": "z"}
    options = CaseOptions(signal=asked, unit={"q": "rad", "v": "rad/s", "u": "N·m"}, time="t")
    made = make_case(path, tmp_path / "case", options)
    again = make_case(
        path, tmp_path / "again", CaseOptions(mapping=tmp_path / "case" / "mapping.json")
    )
    assert again.document == made.document
    assert again.mapping.document() == made.mapping.confirmed().document()
