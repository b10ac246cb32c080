"""Gates: frozen by digest, able to reject, and deaf to what is no number."""

import numpy as np
import pytest

from tests.support.made import episode_bytes, plant_document
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import BadGate, RoleRefused
from trueup.fit.score import Score, Scoring
from trueup.gate.cells import cell_of, matrix
from trueup.gate.decision import Gate, default_gate
from trueup.gate.judge import judge, run_trial
from trueup.gate.rule import Trial, rules
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal

PLANT = Plant.from_document(plant_document())
GATE = default_gate(2.0)


def trial(candidate, incumbent=(1.0, 1.0)):
    return Trial(
        Score(np.array([candidate[1]]), np.array([candidate[0]])), Score(np.array([incumbent[1]]), np.array([incumbent[0]])), ("e" * 64,)
    )


def decide(found, gate=GATE):
    return judge(gate, found, plant="p", candidate="c", incumbent="i", generation=3)


@pytest.mark.parametrize(
    ("candidate", "accepted"),
    [((1.0, 0.97), True), ((1.0, 0.98), False), ((1.1, 0.5), False), ((0.5, 1.0), False), ((np.nan, 0.5), False), ((0.5, np.nan), False)],
)
def test_the_default_gate_accepts_only_better_rollouts_with_one_step_no_worse(candidate, accepted):
    assert decide(trial(candidate)).accepted is accepted


def test_every_reason_is_kept():
    found = decide(trial((2.0, 2.0)))
    assert [v.rule for v in found.verdicts] == ["rollout_improves", "one_step_no_worse"]
    assert not any(v.passed for v in found.verdicts)


def test_a_decision_names_the_generation_and_every_figure():
    document = decide(trial((1.0, np.nan))).document()
    assert document["generation"] == 3
    assert document["figures"]["candidate"] == {"one_step": [1.0], "rollout": [None]}


def test_the_digest_freezes_rules_and_scoring():
    assert Gate.from_document(GATE.document()).digest == GATE.digest
    assert Gate((rules()["rollout_improves"](0.9),), Scoring(2.0)).digest != Gate((rules()["rollout_improves"](0.98),), Scoring(2.0)).digest
    assert default_gate(1.0).digest != default_gate(2.0).digest


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"schema": "trueup.gate/1", "rules": [], "scoring": {"horizon_s": 1.0, "windows": "first"}},
        {"schema": "trueup.gate/1", "rules": [{"rule": "always"}], "scoring": {"horizon_s": 1.0, "windows": "first"}},
        {
            "schema": "trueup.gate/1",
            "rules": [{"rule": "rollout_improves", "ratio": -1}],
            "scoring": {"horizon_s": 1.0, "windows": "first"},
        },
        {"schema": "trueup.gate/1", "rules": [{"rule": "rollout_improves", "slack": 1}], "scoring": {"horizon_s": 1.0, "windows": "first"}},
        {"schema": "trueup.gate/1", "rules": [{"rule": "rollout_improves"}], "scoring": {"horizon_s": 0.0, "windows": "first"}},
        {"schema": "trueup.gate/1", "rules": [{"rule": "rollout_improves"}], "scoring": {"horizon_s": float("nan"), "windows": "first"}},
        {"schema": "trueup.gate/1", "rules": [{"rule": "rollout_improves"}], "scoring": {"horizon_s": 1.0, "windows": "some"}},
        {"schema": "trueup.gate/1", "rules": [{"rule": "rollout_improves"}], "scoring": {"horizon_s": 1.0, "windows": "first"}, "extra": 1},
        {"schema": "trueup.gate/1", "rules": ["rollout_improves"], "scoring": {"horizon_s": 1.0, "windows": "first"}},
    ],
)
def test_a_gate_that_cannot_judge_is_refused(document):
    with pytest.raises(BadGate):
        Gate.from_document(document)


def test_a_trial_without_episodes_is_an_error():
    with pytest.raises(BadGate):
        Trial(Score(np.array([]), np.array([])), Score(np.array([]), np.array([])), ())
    with pytest.raises(BadGate):
        run_trial(GATE, Nominal(PLANT), Nominal(PLANT), [])


@pytest.mark.parametrize("role", [Role.ADAPTATION, Role.TEST, Role.TRAINING, Role.REFERENCE])
def test_a_trial_reads_held_out_episodes_alone(role):
    with pytest.raises(RoleRefused):
        run_trial(GATE, Nominal(PLANT), Nominal(PLANT), [read_episode(episode_bytes(role=role), PLANT.layout)])


def test_a_model_is_no_better_than_itself():
    held_out = [read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)]
    assert not decide(run_trial(GATE, Nominal(PLANT), Nominal(PLANT), held_out)).accepted


def test_one_worse_episode_is_found():
    rule = rules()["no_worse_anywhere"]()
    found = rule(Trial(Score(np.array([0.1, 1.2, 0.1]), np.ones(3)), Score(np.ones(3), np.ones(3)), ("a" * 64, "b" * 64, "c" * 64)))
    assert not found.passed
    assert "b" * 12 in found.because


def test_a_true_model_is_accepted():
    held_out = [read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)]
    assert decide(run_trial(GATE, Identified(PLANT, (1.25, 0.62, 0.82)), Nominal(PLANT), held_out)).accepted


def test_a_gate_with_conditions_and_a_budget_is_another_gate_and_says_so():
    plain, more = Gate(GATE.rules, GATE.scoring), Gate(GATE.rules, GATE.scoring, ("payload", "speed"), 5)
    assert "conditions" not in plain.document()
    assert Gate.from_document(more.document()) == more
    assert more.digest != plain.digest
    for spoil in ({"held_out_uses": 0}, {"held_out_uses": "many"}, {"conditions": 3}):
        with pytest.raises(BadGate):
            Gate.from_document({**more.document(), **spoil})


def test_a_covered_condition_that_gets_worse_rejects_and_is_named():
    rule = rules()["retained_conditions"](1.1)
    names = ("a" * 64, "b" * 64, "c" * 64)
    cells, conditions = (("0", "slow"), ("2 kg", "slow"), ("2 kg", "slow")), ("payload", "speed")
    ones = Score(np.ones(3), np.ones(3))
    better = Trial(Score(np.array([0.1, 0.9, 1.25]), np.ones(3)), ones, names, cells, conditions)
    assert rule(better).passed  # 1.075 of the cell's mean
    worse = rule(Trial(Score(np.array([0.1, 1.0, 1.3]), np.ones(3)), ones, names, cells, conditions))
    assert (worse.passed, worse.because) == (False, "worse in: payload 2 kg, speed slow")
    assert worse.value == pytest.approx(1.15)


def test_cells_that_no_episode_covers_are_told_as_not_covered():
    cells = [("0", "slow"), ("2 kg", "fast")]
    found = matrix(cells, ("payload", "speed"), np.array([0.5, np.nan]), np.ones(2))
    assert [(row["cell"]["payload"], row["cell"]["speed"], row["episodes"], row["candidate"]) for row in found] == [
        ("0", "fast", 0, None),
        ("0", "slow", 1, 0.5),
        ("2 kg", "fast", 1, None),
        ("2 kg", "slow", 0, None),
    ]
    assert cell_of({"payload": "1"}, ("payload", "speed")) == ("1", "undeclared")


def test_an_incumbent_that_runs_away_is_beaten_and_the_decision_can_be_written_down():
    away = trial((0.5, 0.5), (np.inf, np.inf))
    found = decide(away, Gate((rules()["rollout_improves"](), rules()["retained_conditions"]()), GATE.scoring))
    assert found.accepted
    assert [v["threshold"] for v in found.document()["verdicts"]] == [None, None]
    assert len(found.digest) == 64
