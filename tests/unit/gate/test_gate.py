"""Gates: frozen by digest, able to reject, and deaf to what is no number."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.made import episode_bytes, plant_document
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import BadGate, RoleRefused
from trueup.fit.score import EVERY, Score, Scoring, Windowed
from trueup.gate.cells import cell_of, matrix
from trueup.gate.controls import VacuousGate, require_can_reject
from trueup.gate.decision import Gate, default_gate
from trueup.gate.interval import Pairs, ratio_interval
from trueup.gate.judge import _spreads, judge, run_trial, sensitivity
from trueup.gate.recompute import differences, recompute
from trueup.gate.rule import Trial, rules
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal

PLANT = Plant.from_document(plant_document())
GATE = default_gate(2.0)
NEAR = (1.2, 0.6, 0.8)


def trial(candidate, incumbent=(1.0, 1.0)):
    return Trial(
        Score(np.array([candidate[1]]), np.array([candidate[0]])),
        Score(np.array([incumbent[1]]), np.array([incumbent[0]])),
        ("e" * 64,),
    )


def decide(judged_trial, gate=GATE):
    return judge(gate, judged_trial, plant="p", candidate="c", incumbent="i", generation=3)


@pytest.mark.parametrize(
    ("candidate", "accepted"),
    [
        ((1.0, 0.97), True),
        ((1.0, 0.98), False),
        ((1.1, 0.5), False),
        ((0.5, 1.0), False),
        ((np.nan, 0.5), False),
        ((0.5, np.nan), False),
    ],
)
def test_the_default_gate_accepts_only_better_rollouts_with_one_step_no_worse(candidate, accepted):
    assert decide(trial(candidate)).accepted is accepted


def test_every_reason_is_kept():
    decision = decide(trial((2.0, 2.0)))
    assert [v.rule for v in decision.verdicts] == ["rollout_improves", "one_step_no_worse"]
    assert not any(v.passed for v in decision.verdicts)


def test_a_decision_names_the_generation_and_every_figure():
    document = decide(trial((1.0, np.nan))).document()
    assert document["generation"] == 3
    assert document["figures"]["candidate"] == {"one_step": [1.0], "rollout": [None]}


def test_the_digest_freezes_rules_and_scoring():
    assert Gate.from_document(GATE.document()).digest == GATE.digest
    assert (
        Gate((rules()["rollout_improves"](0.9),), Scoring(2.0)).digest
        != Gate((rules()["rollout_improves"](0.98),), Scoring(2.0)).digest
    )
    assert default_gate(1.0).digest != default_gate(2.0).digest


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"schema": "trueup.gate/1", "rules": [], "scoring": {"horizon_s": 1.0, "windows": "first"}},
        {
            "schema": "trueup.gate/1",
            "rules": [{"rule": "always"}],
            "scoring": {"horizon_s": 1.0, "windows": "first"},
        },
        {
            "schema": "trueup.gate/1",
            "rules": [{"rule": "rollout_improves", "ratio": -1}],
            "scoring": {"horizon_s": 1.0, "windows": "first"},
        },
        {
            "schema": "trueup.gate/1",
            "rules": [{"rule": "rollout_improves", "slack": 1}],
            "scoring": {"horizon_s": 1.0, "windows": "first"},
        },
        {
            "schema": "trueup.gate/1",
            "rules": [{"rule": "rollout_improves"}],
            "scoring": {"horizon_s": 0.0, "windows": "first"},
        },
        {
            "schema": "trueup.gate/1",
            "rules": [{"rule": "rollout_improves"}],
            "scoring": {"horizon_s": float("nan"), "windows": "first"},
        },
        {
            "schema": "trueup.gate/1",
            "rules": [{"rule": "rollout_improves"}],
            "scoring": {"horizon_s": 1.0, "windows": "some"},
        },
        {
            "schema": "trueup.gate/1",
            "rules": [{"rule": "rollout_improves"}],
            "scoring": {"horizon_s": 1.0, "windows": "first"},
            "extra": 1,
        },
        {
            "schema": "trueup.gate/1",
            "rules": ["rollout_improves"],
            "scoring": {"horizon_s": 1.0, "windows": "first"},
        },
    ],
)
def test_a_gate_that_cannot_judge_is_refused(document):
    with pytest.raises(BadGate):
        Gate.from_document(document)


@pytest.mark.parametrize(
    "field",
    [
        {"held_out_uses": True},
        {"held_out_uses": 2.9},
        {"conditions": "payload"},
        {"because": ["a"], "vacuous": True},
        {"vacuous": "true", "because": "a"},
        {"follows": 7, "because": "a"},
        {"scoring": {"horizon_s": True, "windows": "first"}},
        {"scoring": {"horizon_s": 1.0, "windows": "first", "step": 2}},
        {"rules": [{"rule": "one_step_no_worse", "slack": True}]},
        {"rules": [{"rule": "one_step_no_worse", "slack": "2"}]},
    ],
)
def test_a_gate_is_read_as_it_was_sent_and_nothing_is_made_of_another_kind(field):
    document = {
        "schema": "trueup.gate/1",
        "rules": [{"rule": "rollout_improves"}],
        "scoring": {"horizon_s": 1.0, "windows": "first"},
    }
    Gate.from_document(document)
    with pytest.raises(BadGate):
        Gate.from_document({**document, **field})


def test_a_trial_without_episodes_is_an_error():
    with pytest.raises(BadGate):
        Trial(Score(np.array([]), np.array([])), Score(np.array([]), np.array([])), ())
    with pytest.raises(BadGate):
        run_trial(GATE, Nominal(PLANT), Nominal(PLANT), [])


@pytest.mark.parametrize("role", [Role.ADAPTATION, Role.TEST, Role.TRAINING, Role.REFERENCE])
def test_a_trial_reads_held_out_episodes_alone(role):
    with pytest.raises(RoleRefused):
        run_trial(
            GATE,
            Nominal(PLANT),
            Nominal(PLANT),
            [read_episode(episode_bytes(role=role), PLANT.layout)],
        )


def test_a_model_is_no_better_than_itself():
    held_out = [read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)]
    assert not decide(run_trial(GATE, Nominal(PLANT), Nominal(PLANT), held_out).trial).accepted


def test_one_worse_episode_is_found():
    rule = rules()["no_worse_anywhere"]()
    verdict = rule(
        Trial(
            Score(np.array([0.1, 1.2, 0.1]), np.ones(3)),
            Score(np.ones(3), np.ones(3)),
            ("a" * 64, "b" * 64, "c" * 64),
        )
    )
    assert not verdict.passed
    assert "b" * 12 in verdict.because


def test_a_true_model_is_accepted():
    held_out = [read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)]
    assert decide(
        run_trial(GATE, Identified(PLANT, (1.25, 0.62, 0.82)), Nominal(PLANT), held_out).trial
    ).accepted


def test_a_gate_with_conditions_and_a_budget_is_another_gate_and_says_so():
    plain, more = (
        Gate(GATE.rules, GATE.scoring),
        Gate(GATE.rules, GATE.scoring, ("payload", "speed"), 5),
    )
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
    worse = rule(
        Trial(Score(np.array([0.1, 1.0, 1.3]), np.ones(3)), ones, names, cells, conditions)
    )
    assert (worse.passed, worse.because) == (False, "worse in: payload 2 kg, speed slow")
    assert worse.value == pytest.approx(1.15)


def test_cells_that_no_episode_covers_are_told_as_not_covered():
    cells = [("0", "slow"), ("2 kg", "fast")]
    rows = matrix(cells, ("payload", "speed"), np.array([0.5, np.nan]), np.ones(2))
    assert [
        (row["cell"]["payload"], row["cell"]["speed"], row["episodes"], row["candidate"])
        for row in rows
    ] == [
        ("0", "fast", 0, None),
        ("0", "slow", 1, 0.5),
        ("2 kg", "fast", 1, None),
        ("2 kg", "slow", 0, None),
    ]
    assert cell_of({"payload": "1"}, ("payload", "speed")) == ("1", "undeclared")


def test_an_incumbent_that_runs_away_is_beaten_and_the_decision_can_be_written_down():
    away = trial((0.5, 0.5), (np.inf, np.inf))
    decision = decide(
        away, Gate((rules()["rollout_improves"](), rules()["retained_conditions"]()), GATE.scoring)
    )
    assert decision.accepted
    assert [v["threshold"] for v in decision.document()["verdicts"]] == [None, None]
    assert len(decision.digest) == 64


def windowed(rollout, one_step=None):
    """A score of one episode by its windows."""
    rollout = np.asarray(rollout, np.float64)
    one_step = rollout if one_step is None else np.asarray(one_step, np.float64)
    return Score(
        rollout.mean(keepdims=True),
        one_step.mean(keepdims=True),
        (Windowed(rollout, one_step, np.ones(len(rollout))),),
    )


def test_every_verdict_carries_the_interval_of_its_ratio():
    rng = np.random.default_rng(1)
    incumbent = rng.lognormal(sigma=0.3, size=60)
    windowed_trial = Trial(
        windowed(incumbent * rng.lognormal(-0.2, 0.1, 60)), windowed(incumbent), ("a" * 64,)
    )
    for kind in rules().values():
        if not kind.closed_loop:
            verdict = kind()(windowed_trial)
            assert verdict.ci95[0] < verdict.ratio < verdict.ci95[1] < 1.0
            assert verdict.document()["ci95"] == list(verdict.ci95)


def test_a_rule_can_require_the_bound_instead_of_the_mean():
    # 0.9 of the error on average, and nobody knows whether it is less than 1
    incumbent, swing = np.ones(40), np.tile([0.2, 1.6], 20)
    windowed_trial = Trial(windowed(swing), windowed(incumbent), ("a" * 64,))
    rng_swing = Trial(
        windowed(np.random.default_rng(0).permutation(swing)), windowed(incumbent), ("a" * 64,)
    )
    assert rules()["rollout_improves"](0.98)(windowed_trial).passed
    verdict = rules()["rollout_improves"](0.98, "bound")(rng_swing)
    assert not verdict.passed
    assert verdict.ci95[1] > 0.98
    assert rules()["rollout_improves"](0.98, "bound")(
        Trial(windowed(0.5 * swing), windowed(incumbent), ("a" * 64,))
    ).passed


def test_the_interval_of_windows_that_hang_together_is_wider_than_that_of_independent_ones():
    rng = np.random.default_rng(2)
    steps = rng.normal(size=400)
    errors = np.array([0.0] * 400)
    for i in range(1, 400):
        errors[i] = 0.9 * errors[i - 1] + steps[i]
    together = np.exp(0.2 * errors)
    apart = rng.permutation(together)
    widths = []
    for candidate in (together, apart):
        low, high = ratio_interval([Pairs(candidate, np.ones(400), np.ones(400))])
        widths.append(high - low)
    assert widths[0] > 1.5 * widths[1]


def test_the_interval_covers_what_it_should():
    """Windows of a moving average, whose ratio is known: 95 % of intervals hold it, less the little
    that a short log costs."""
    rng, held, tries = np.random.default_rng(3), 0, 300
    for _ in range(tries):
        noise = rng.normal(size=(2, 121))
        candidate, incumbent = 1.0 + 0.1 * (noise[:, 1:] + noise[:, :-1])
        low, high = ratio_interval([Pairs(candidate, incumbent, np.ones(120))])
        held += low <= 1.0 <= high
    assert 0.88 <= held / tries <= 0.98


def test_one_window_has_no_interval_and_does_not_pass_where_the_bound_is_required():
    one = Trial(windowed([0.1]), windowed([1.0]), ("a" * 64,))
    verdict = rules()["rollout_improves"](0.98, "bound")(one)
    assert (verdict.passed, verdict.ci95) == (False, None)
    assert "no interval" in verdict.because
    assert rules()["rollout_improves"](0.98)(one).passed


GATE_1 = {"schema": "trueup.gate/1", "scoring": {"horizon_s": 1.0, "windows": "every"}}


@pytest.mark.parametrize(
    "given",
    [
        [{"rule": "rollout_improves", "ratio": 1e9}],
        [{"rule": "rollout_improves"}, {"rule": "one_step_no_worse", "slack": 1e9}],
        [{"rule": "one_step_no_worse"}],
        [
            {"rule": "no_worse_anywhere"},
            {"rule": "retained_conditions"},
            {"rule": "tracking_no_worse"},
        ],
        [{"rule": "rollout_improves", "ratio": 1.01}],
    ],
)
def test_a_gate_that_cannot_reject_is_refused_unless_it_says_so(given):
    with pytest.raises(VacuousGate):
        require_can_reject(Gate.from_document({**GATE_1, "rules": given}))
    require_can_reject(
        Gate.from_document(
            {
                **GATE_1,
                "rules": given,
                "vacuous": True,
                "because": "the first model of this machine",
            }
        )
    )


@pytest.mark.parametrize(
    "given",
    [
        [{"rule": "rollout_improves"}, {"rule": "one_step_no_worse"}],
        [
            {"rule": "rollout_improves", "ratio": 1.0},
            {"rule": "tracking_no_worse"},
            {"rule": "retained_conditions", "slack": 9.0},
        ],
        [{"rule": "rollout_improves", "require": "bound"}],
        [{"rule": "rollout_improves", "require": "bound", "ratio": 1.0}],
    ],
)
def test_a_gate_that_can_reject_is_not(given):
    require_can_reject(Gate.from_document({**GATE_1, "rules": given}))


def test_the_controls_are_judged_and_told():
    held_out = [read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)]
    run = run_trial(default_gate(0.5), Identified(PLANT, NEAR), Nominal(PLANT), held_out)
    assert {name: control["accepted"] for name, control in run.controls.items()} == {
        "incumbent": False,
        "copy": False,
        "noise": False,
    }
    assert run.controls["noise"]["failed"] == ["rollout_improves", "one_step_no_worse"]
    assert run.controls["copy"]["failed"] == ["rollout_improves"]


def test_a_channel_that_no_episode_observed_adds_no_noise_to_the_controls():
    episode = read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)
    blind = replace(episode, observations=np.where([False, True], np.nan, episode.observations))
    run = run_trial(default_gate(0.5), Identified(PLANT, NEAR), Nominal(PLANT), [blind])
    assert run.controls["noise"]["accepted"] is False
    assert np.isfinite(_spreads([blind])).all()


def test_a_gate_that_accepts_a_control_judges_nobody():
    held_out = [read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)]
    # as it may have been declared before this was asked
    lenient = Gate((rules()["one_step_no_worse"](),), Scoring(0.5, EVERY))
    with pytest.raises(VacuousGate, match="the incumbent itself"):
        run_trial(lenient, Identified(PLANT, NEAR), Nominal(PLANT), held_out)
    meant = Gate(lenient.rules, lenient.scoring, vacuous=True, because="a first model")
    assert run_trial(meant, Identified(PLANT, NEAR), Nominal(PLANT), held_out).controls["copy"] == {
        "accepted": True,
        "failed": [],
    }


def test_how_the_verdict_hangs_on_the_reporting_scales():
    held_out = [read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)]
    gate = default_gate(0.5)
    run = run_trial(gate, Identified(PLANT, NEAR), Nominal(PLANT), held_out)
    rows = sensitivity(gate, run, PLANT.scales, [c.name for c in PLANT.layout.observations])
    assert [(row["channel"], row["factor"]) for row in rows] == [
        ("q", 0.5),
        ("q", 2.0),
        ("v", 0.5),
        ("v", 2.0),
    ]
    finer = Plant.from_document(
        {
            **plant_document(),
            "observations": [
                {"name": "q", "unit": "m", "scale": 0.5},
                plant_document()["observations"][1],
            ],
        }
    )
    anew = decide(run_trial(gate, Identified(finer, NEAR), Nominal(finer), held_out).trial, gate)
    assert rows[0]["verdicts"][0]["value"] == pytest.approx(anew.verdicts[0].value)
    assert rows[0]["verdicts"][0]["value"] != rows[1]["verdicts"][0]["value"]


def test_a_decision_of_before_intervals_is_recomputed_as_far_as_it_tells():
    held_out = [read_episode(episode_bytes(role=Role.VALIDATION), PLANT.layout)]
    lenient = Gate((rules()["one_step_no_worse"](),), Scoring(0.5, EVERY))
    names = {"candidate": "c" * 64, "incumbent": "i" * 64, "generation": 1}
    both = {"candidate": Identified(PLANT, NEAR), "incumbent": Nominal(PLANT)}
    meant = Gate(lenient.rules, lenient.scoring, vacuous=True, because="as then")
    old = judge(
        lenient, run_trial(meant, *both.values(), held_out).trial, plant="p", **names
    ).document()
    for key in ("known", "uses"):
        del old[key]
    del old["figures"]["controls"]
    for verdict in old["verdicts"]:
        for key in ("ratio", "ci95", "require"):
            del verdict[key]
    assert differences(old, recompute(old, lenient.document(), both, held_out, "p")) == []
    old["verdicts"][0]["value"] *= 1.001
    assert len(differences(old, recompute(old, lenient.document(), both, held_out, "p"))) == 1
