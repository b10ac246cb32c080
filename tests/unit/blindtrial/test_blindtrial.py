"""Blind trials: drawn after the user's log, committed before the diagnosis, and no label gets out
unnoticed."""

import json
import os
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.support.robots import ARM, arm_document, arm_plant
from tests.support.robots import recorded as robot_recorded
from tests.support.simulated import recorded_twice as recorded
from trueup.blindtrial import conduct as conducting
from trueup.blindtrial.commitment import (
    CommitmentMismatch,
    LabelLeaked,
    commitment,
    require_commitments,
    require_no_leak,
    salt_of,
)
from trueup.blindtrial.conduct import side_by_side
from trueup.blindtrial.scoring import (
    Answer,
    _improbable,
    _truth_and_answer,
    answer_words,
    bound_holds,
    lower_bound,
    score_answer,
)
from trueup.blindtrial.specification import draw_specifications
from trueup.blindtrial.trial_plant import trial_plant
from trueup.diagnose.case import read_case
from trueup.errors import NotIdentifiable
from trueup.model.effect import effects
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup_pages.blindtrial import page
from trueup_worker import blind_trial
from trueup_worker.isolated_process import IsolatedProcess

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

SECRET = bytes(range(32))
LABEL = {
    "kind": "single",
    "effects": {"coulomb_friction": {"level": 0.2}},
    "moved": True,
    "bait": None,
    "gap": 0.1,
}
COUNT = 10


def _answer(verdict, effects=(), others=(), excluded=()):
    named = [{"effect": e, "estimate": {}} for e in effects]
    return Answer(
        {
            "verdict": verdict,
            "effects": named,
            "indistinguishable": list(others),
            "excluded": list(excluded),
        },
        None,
        1.0,
    )


def _absorbed(plant):
    return trial_plant(plant).absorbed_terms()


@cache
def users():
    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 3)
    return plant, episodes


@pytest.fixture(scope="module")
def conducted():
    happened = []

    def diagnosed(folder: Path):
        happened.append("asked")
        assert sorted(p.suffix for p in folder.iterdir()) == [".json"] + [".mcap"] * len(users()[1])
        return real(folder)

    with IsolatedProcess(min(os.sched_getaffinity(0))) as real:
        committed = []
        plant, episodes = users()

        def commit(labels):
            committed.extend(labels)
            happened.append("committed")

        document = blind_trial.conduct(
            plant, episodes, COUNT, SECRET, commit, lambda *_: None, side_by_side([diagnosed])
        )
    return document, committed, happened


def test_labels_are_committed_before_anybody_is_asked(conducted):
    document, committed, happened = conducted
    assert happened == ["committed"] + ["asked"] * COUNT
    require_commitments(document, committed)
    assert [r["commitment"] for r in document["rows"]] == committed


def test_a_label_changed_after_its_commitment_is_found(conducted):
    document, committed, _ = conducted
    forged = json.loads(json.dumps(document))
    forged["rows"][3]["label"]["effects"] = {
        "cogging": {"amplitude": 1.0, "pitch": 0.2, "phase": 0.0}
    }
    with pytest.raises(CommitmentMismatch, match="trial 3"):
        require_commitments(forged, committed)
    with pytest.raises(CommitmentMismatch, match="were opened"):
        require_commitments({**document, "rows": document["rows"][1:]}, committed)


def test_the_secret_draws_the_same_trials_again(conducted, tmp_path):
    document, committed, _ = conducted
    plant, episodes = users()
    source, conditions = trial_plant(plant), conducting.conditions_of(episodes)
    again = list(
        conducting._draw(
            source,
            source.bench(episodes),
            conditions,
            COUNT,
            bytes.fromhex(document["opening"]["secret"]),
            tmp_path,
        )
    )
    assert [s.commitment for s in again] == committed
    assert salt_of(SECRET, 0) != salt_of(SECRET, 1)


def test_single_effects_of_a_plain_oscillator_are_mostly_named(conducted):
    document, _, _ = conducted
    assert document["kinds"]["single"]["n"] == 6
    assert document["kinds"]["single"]["exact"]["share"] >= 5 / 6
    assert document["closed"]["median"] > 0.95
    assert not document["leak"]["void"]
    assert sum(c["n"] for c in document["confusion"]) + document["kinds"]["faint"]["n"] == COUNT
    assert "<svg" in page(document)


def test_a_planted_leak_is_caught_by_its_words(monkeypatch):
    plain = conducting.case_files
    monkeypatch.setattr(
        conducting,
        "case_files",
        lambda p, t, c: plain(p, t, c | {"note": " ".join(t.machine.imperfections)}),
    )
    with pytest.raises(LabelLeaked, match="spells"):
        blind_trial.conduct(*users(), 5, SECRET, lambda _: None, lambda *_: None, side_by_side([]))
    require_no_leak({"a.mcap": b"no word of it"}, LABEL, "5a17", {})
    with pytest.raises(LabelLeaked, match=r"a\.mcap spells 'coulomb_friction'"):
        require_no_leak({"a.mcap": b"xx coulomb_friction xx"}, LABEL, "5a17", {})
    with pytest.raises(LabelLeaked, match=r"coulomb_friction\.mcap"):
        require_no_leak({"coulomb_friction.mcap": b""}, LABEL, "5a17", {})
    require_no_leak(
        {"plant.json": b"my coulomb_friction rig"},
        LABEL,
        "5a17",
        {"name": "my coulomb_friction rig"},
    )
    with pytest.raises(LabelLeaked):
        require_no_leak({"a.mcap": b"salt 5a17"}, LABEL, "5a17", {})


def test_a_planted_leak_that_spells_no_word_takes_the_decoy(monkeypatch):
    """Labels are smuggled through in hexadecimal; the cheat that reads them knows even what no
    recording holds."""
    hidden, plain = {}, conducting.case_files

    def smuggled(plant, trial, conditions):
        return plain(plant, trial, {**conditions, "machine": hidden["next"].encode().hex()})

    def label_of(plant, specification, trial, real=conducting.label_of):
        label = real(plant, specification, trial)
        hidden["next"] = label["bait"] or "+".join(label["effects"])
        return label

    monkeypatch.setattr(conducting, "label_of", label_of)
    monkeypatch.setattr(conducting, "case_files", smuggled)

    def cheat(folder: Path):
        _, episodes = read_case(folder)
        names = bytes.fromhex(episodes[0].conditions["machine"]).decode().split("+")
        report = dict(_answer("effect", [n for n in names if n]).report) | {
            "gap": {"closed": None},
            "parameters": {},
            "evidence": {"unexplained": 0.0},
        }
        return {"report": report, "seconds": 0.1}

    plant, episodes = users()
    document = blind_trial.conduct(
        plant, episodes, 20, SECRET, lambda _: None, lambda *_: None, side_by_side([cheat])
    )
    assert document["leak"]["baits"] == 2
    assert document["leak"]["taken"] == 2
    assert document["leak"]["void"]
    assert "Void" in page(document)


def test_an_isolated_process_knows_nothing_of_its_makers_environment(monkeypatch):
    monkeypatch.setenv("TRUEUP_DATABASE_URL", "postgresql://somebody:secret@somewhere/labels")
    with IsolatedProcess(min(os.sched_getaffinity(0))) as process:
        answer = process(Path("/nowhere"))
        assert b"secret" not in Path(f"/proc/{process._process.pid}/environ").read_bytes()
    assert answer["problem"].startswith("bad-plant")


def test_an_isolated_process_that_dies_is_started_once_more(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with IsolatedProcess(min(os.sched_getaffinity(0))) as process:
        process(Path("some where"))
        process._process.kill()
        process._process.wait()
        answer = process(Path("some where"))
        assert answer["problem"].startswith("bad-plant")
        assert str(tmp_path) in answer["problem"]  # a relative folder is found from anywhere


def test_processes_that_never_answer_end_the_trial():
    with pytest.raises(blind_trial.NoIsolatedProcess, match="code 1"):
        blind_trial.conduct(
            *users(),
            2,
            SECRET,
            lambda _: None,
            lambda *_: None,
            side_by_side([lambda _: {"problem": "no-answer: ended with code 1", "seconds": 0.0}]),
        )


def test_a_diagnosis_that_breaks_is_a_miss_of_its_machine_alone():
    document = blind_trial.conduct(
        *users(),
        3,
        SECRET,
        lambda _: None,
        lambda *_: None,
        side_by_side([lambda _: {"problem": "failed: KeyError: 3", "seconds": 0.1}]),
    )
    assert document["refused"] == 3
    assert not any(r["exact"] for r in document["rows"])
    assert document["leak"]["void"] is False


def test_a_decoy_taken_once_in_many_may_be_chance():
    assert _improbable(1, 6) is True
    assert _improbable(1, 200) is False
    assert _improbable(4, 200) is True
    assert _improbable(0, 6) is False
    assert _improbable(0, 0) is None


def test_specifications_come_in_their_proportions_and_every_effect_in_turn():
    plant, _ = users()
    drawn = draw_specifications(trial_plant(plant), 100, np.random.default_rng(1))
    assert Counter(spec.kind for spec in drawn) == {
        "single": 60,
        "pair": 12,
        "outside": 10,
        "none": 10,
        "faint": 8,
    }
    singles = Counter(spec.effects for spec in drawn if spec.kind == "single")
    assert len(singles) == len(effects())
    assert max(singles.values()) - min(singles.values()) <= 1
    assert all(len(set(spec.effects)) == 2 for spec in drawn if spec.kind == "pair")
    assert all(spec.decoy for spec in drawn if spec.kind == "none")


def test_what_a_plant_cannot_show_is__absorbed():
    assert _absorbed(recorded("B2", [], 1, shifted=False)[0]) == ("sensor_bias",)
    assert _absorbed(recorded("A1", [], 1, shifted=False, velocity=False)[0]) == (
        "velocity_lag",
        "sensor_scale",
        "clock_skew",
    )
    assert "sensor_drift" in _absorbed(recorded("B2", [], 1, shifted=False, velocity=False)[0])


def test_the_bench_takes_after_the_log():
    plant, episodes = users()
    bench = trial_plant(plant).bench(episodes)
    assert [p.role for p in bench.recorded] == [
        str(e.role) for e in sorted(episodes, key=lambda e: e.digest)
    ]
    assert bench.timestep_s == pytest.approx(plant.timestep_s)
    assert bench.timestep_s / bench.parts <= 5e-4
    first = min(episodes, key=lambda e: e.digest)
    assert np.array_equal(bench.recorded[0].series, plant.applied(first.commands)[:, 0])
    assert bench.feedback is None
    inertia, looped, _ = recorded("B2", [], 1, shifted=False)
    assert trial_plant(inertia).bench(looped).feedback is not None
    with pytest.raises(NotIdentifiable, match="no validation episode"):
        trial_plant(plant).bench([e for e in episodes if e.role != "validation"])


@pytest.mark.parametrize(
    ("label", "answer", "expected"),
    [
        (LABEL, _answer("effect", ["coulomb_friction"]), (True, True, 0)),
        (LABEL, _answer("effect", ["deadband"], [["coulomb_friction"]]), (False, True, 0)),
        (LABEL, _answer("effect", ["coulomb_friction"], [["deadband"]]), (True, True, 1)),
        (LABEL, _answer("parameters_only"), (False, False, 0)),
        (
            LABEL | {"effects": {"sensor_delay": {}}},
            _answer("effect", ["actuator_delay"], [["sensor_delay"]]),
            (True, True, 0),
        ),
        (
            LABEL | {"effects": {"sensor_bias": {}}},
            _answer("effect", ["constant_force"], [["sensor_bias"]]),
            (True, True, 0),
        ),
        (
            LABEL | {"effects": {"sensor_bias": {}}},
            _answer("effect", ["constant_force"]),
            (False, False, 0),
        ),
        (
            LABEL | {"kind": "none", "effects": {}, "bait": "cogging"},
            _answer("no_gap"),
            (False, False, 0),
        ),
        (
            LABEL | {"kind": "none", "effects": {}, "bait": "cogging", "moved": False},
            _answer("no_gap"),
            (True, True, 0),
        ),
        (
            LABEL | {"kind": "outside", "effects": {"van_der_pol": {}}},
            _answer("unknown_effect", ["cogging"]),
            (True, True, 0),
        ),
        (
            LABEL | {"kind": "outside", "effects": {"van_der_pol": {}}},
            _answer("effect", ["cogging"]),
            (False, False, 0),
        ),
        (LABEL, Answer(None, "bad-plant: no", 0.0), (False, False, 0)),
    ],
)
def test_an_answer_is_scored(label, answer, expected):
    score = score_answer(label, answer)
    assert (score["exact"], score["in_set"], score["alternatives"]) == expected


def test_a_bound_holds_or_does_not():
    entry = {"effect": "coulomb_friction", "parameter": "level", "below": 0.1}
    assert bound_holds(LABEL, _answer("no_gap", excluded=[entry])) is False
    assert bound_holds(LABEL, _answer("no_gap", excluded=[entry | {"below": 0.3}])) is True
    assert bound_holds(LABEL, _answer("no_gap")) is None


def test_few_trials_promise_little():
    assert lower_bound(5, 5) == pytest.approx(0.649, abs=0.01)
    assert lower_bound(0, 0) == 0.0
    assert lower_bound(95, 100) < 0.95


def test_a_commitment_hides_behind_its_salt():
    assert commitment(LABEL, "1") != commitment(LABEL, "2")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    plant = arm_plant(tmp_path_factory.mktemp("arm"))
    return plant, robot_recorded(
        plant, lambda _spec: None, range(3), ("adaptation", "adaptation", "validation"), seconds=1.5
    )


def test_a_robots_effects_act_at_joints_by_lot_and_a_pair_at_two(arm):
    plant, _ = arm
    drawn = draw_specifications(trial_plant(plant), 400, np.random.default_rng(0))
    singles = Counter(spec.effects[0] for spec in drawn if spec.kind == "single")
    assert {t.partition("@")[2] for t in singles} == {"", "1"}
    assert {t for t in singles if t.startswith(("clock_skew", "dropped_frames"))} == {
        "clock_skew",
        "dropped_frames",
    }
    pairs = [spec.effects for spec in drawn if spec.kind == "pair"]
    assert pairs
    assert all(first.partition("@")[2] != second.partition("@")[2] for first, second in pairs)


def test_a_joint_about_the_vertical_and_the_last_one_hide_a_bias(tmp_path):
    upright = ARM.replace('name="shoulder" axis="0 1 0"', 'name="shoulder" axis="0 0 1"')
    (tmp_path / "arm.xml").write_text(upright)
    plant = Plant.from_document(resolved(arm_document(), tmp_path))
    assert _absorbed(plant) == ("sensor_bias", "sensor_bias@1")


def test_at_a_servo_gears_rub_and_springs_give(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.replace("motor", 'position kp="30"'))
    plant = Plant.from_document(resolved(arm_document(), tmp_path))
    assert not [
        t
        for t in _absorbed(plant)
        if t.startswith(("load_dependent_friction", "elastic_transmission"))
    ]


def test_a_blind_trial_of_a_robot_names_effect_and_joint(arm):
    plant, episodes = arm
    committed = []

    document = blind_trial.conduct(plant, episodes, 2, SECRET, committed.extend, lambda *_: None)
    assert [r["commitment"] for r in document["rows"]] == committed
    assert {r["label"]["kind"] for r in document["rows"]} == {"none", "single"}
    single = next(r for r in document["rows"] if r["label"]["kind"] == "single")
    assert list(single["label"]["effects"]) == ["quadratic_gain at elbow"]  # by this secret
    assert all(r["in_set"] for r in document["rows"])
    assert "the robot's links by MuJoCo" in page(document)


def test_an_answer_at_another_joint_is_wrong_and_scored_so():
    label = {
        "kind": "single",
        "effects": {"cogging at elbow": {}},
        "moved": True,
        "bait": None,
        "gap": 0.1,
    }

    def answered(joint):
        report = {
            "verdict": "effect",
            "effects": [{"effect": "cogging", "joint": joint, "estimate": {}}],
            "indistinguishable": [],
        }
        return Answer(report, None, 1.0)

    assert score_answer(label, answered("elbow"))["exact"]
    assert not score_answer(label, answered("shoulder"))["exact"]
    row = {"label": label, "answer": answer_words(answered("shoulder"))}
    assert _truth_and_answer(row) == ("cogging", "cogging, at another joint")
    assert _truth_and_answer(row | {"answer": answer_words(answered("elbow"))}) == (
        "cogging",
        "cogging",
    )
