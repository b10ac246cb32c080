"""A monitor: calibrated on healthy episodes, silent while they stay so, and what it says when they
do not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import episode_of, plant_of
from trueup.episode.role import Role
from trueup.errors import BadMonitor, NotAnEpisode, NotIdentifiable
from trueup.model.predictor import Nominal
from trueup.monitor.achieved import poisson_interval
from trueup.monitor.change import Before, changed, onset
from trueup.monitor.detector import detectors
from trueup.monitor.monitor import Monitor, _halves, calibrate
from trueup.monitor.residuals import blocks, unscaled_residuals
from trueup.simulate.excitation import SHAPES, planned
from trueup.simulate.machine import Machine, run
from trueup.simulate.trial import JointBench

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

BENCH = JointBench("oscillator", 2.0, 0.5, 1.0, 1.0, 0.02, 20, 8.0, 0.01, None, 1.0)
PLANT = plant_of(BENCH)
SIGMA = (0.005, 0.01)
KINDS = ("quantile_run", "likelihood_ratio_cusum", "effect_cusum")


def machine(**imperfections):
    made = Machine(BENCH.kind, BENCH.k, BENCH.c, BENCH.b, BENCH.limit)
    for name, values in imperfections.items():
        made = made.having(name, values)
    return made


def recorded(of, seed, seconds=8.0, role=Role.REFERENCE):
    rng = np.random.default_rng(seed)
    series = planned(SHAPES[seed % 4], round(seconds / BENCH.timestep_s) + 1, BENCH.timestep_s, rng)
    return episode_of(
        PLANT, run(of, series, BENCH.timestep_s, BENCH.parts, SIGMA, rng), role, f"{seed:04d}"
    )


@pytest.fixture(scope="module")
def reference():
    return [recorded(machine(), i) for i in range(60)]


def test_halves_have_as_much_of_every_kind_and_take_no_pattern(reference):
    rare = [
        replace(e, conditions={"payload": "2 kg" if i < 6 else "none", "run": str(i)})
        for i, e in enumerate(reference)
    ]
    for seed in range(20):
        first, second = _halves(rare, np.random.default_rng(seed))
        assert sorted([*first, *second]) == list(range(60))
        assert [
            sum(rare[i].conditions["payload"] == "2 kg" for i in half) for half in (first, second)
        ] == [3, 3]
    assert len({tuple(_halves(rare, np.random.default_rng(seed))[0]) for seed in range(20)}) == 20


@pytest.fixture(scope="module")
def monitor(reference):
    return calibrate(Nominal(PLANT), "served", reference, 1.0, kinds=KINDS)


def followed(monitor, machines, first=1000):
    state, seen = monitor.begin(), []
    for i, of in enumerate(machines):
        state, one = monitor.follow(state, Nominal(PLANT), recorded(of, first + i))
        seen.append(one)
    return seen


def test_healthy_episodes_are_as_far_off_as_the_reference_and_raise_nothing(monitor):
    seen = followed(monitor, [machine()] * 30)
    assert not any(s.alarms for s in seen)
    assert np.mean([s.rms for s in seen], axis=0) == pytest.approx([1.0, 1.0], abs=0.15)


def test_friction_that_grows_is_found_and_what_it_is_like_is_said(monitor):
    seen = followed(monitor, [machine(coulomb_friction={"level": 0.003 * i}) for i in range(12)])
    first = next(i for i, s in enumerate(seen) if s.alarms)
    assert 1 <= first <= 8
    leading = {d: words for s in seen for d, (_, words) in s.alarms.items()}
    assert leading["effect_cusum"].startswith("like more")
    assert "friction" in next(
        words for s in seen for d, (_, words) in s.alarms.items() if d == "effect_cusum"
    )


def test_a_monitor_comes_back_from_its_document_as_it_was(monitor):
    again = Monitor.from_document(monitor.document())
    assert again.digest == monitor.digest
    state = monitor.begin()
    episode = recorded(machine(), 7000)
    assert (
        again.follow(state, Nominal(PLANT), episode)[0]
        == monitor.follow(state, Nominal(PLANT), episode)[0]
    )


def test_the_promise_is_shared_by_the_detectors_and_what_was_achieved_stands_beside_it(monitor):
    of = monitor.figures["detectors"]
    assert [f["promised_per_h"] for f in of.values()] == pytest.approx([1.0 / 3.0] * 3)
    for figures in of.values():
        low, high = figures["alarms_per_h_ci95"]
        assert low <= figures["alarms_per_h"] <= high
        assert all(delay["episodes"] == 20 for delay in figures["delays"].values())
    assert of["likelihood_ratio_cusum"]["delays"]["the spread of a channel doubles"]["found"] == 1.0
    assert of["effect_cusum"]["delays"]["an effect moves a channel by its spread"]["found"] > 0.5
    # a cutoff does not add up
    assert of["quantile_run"]["delays"]["the mean of a channel moves by its spread"]["found"] < 0.5
    assert not monitor.figures["promise_shown"]  # eight minutes show no hour


@pytest.mark.parametrize(
    ("promise_h", "kinds"), [(0.0, ()), (float("nan"), ()), (1.0, ("crystal_ball",))]
)
def test_a_monitor_that_cannot_watch_is_refused(reference, promise_h, kinds):
    with pytest.raises(BadMonitor):
        calibrate(Nominal(PLANT), "served", reference, promise_h, kinds=kinds)


@pytest.mark.parametrize("count", [1, 4])
def test_too_short_a_reference_is_refused_and_says_how_much_is_needed(reference, count):
    with pytest.raises(NotIdentifiable, match="too few") as refused:
        calibrate(Nominal(PLANT), "served", reference[:count], 1.0)
    assert "16 blocks" in refused.value.hint


@pytest.mark.parametrize(
    "spoil",
    [
        {"schema": "other"},
        {"healthy": [[0.0]]},
        {"detectors": [{"detector": "none"}]},
        {"windows": None},
    ],
)
def test_a_spoiled_document_is_refused(monitor, spoil):
    with pytest.raises(BadMonitor):
        Monitor.from_document({**monitor.document(), **spoil})


def test_residuals_begin_anew_with_every_window_and_leave_its_start_out():
    residuals = unscaled_residuals(Nominal(PLANT), recorded(machine(), 1))
    assert len(residuals.first) == 4
    assert residuals.age.min() > 0.0
    assert residuals.age.max() == pytest.approx(1.0, abs=0.02)
    assert not set(residuals.rows) & set(residuals.first)
    assert set(residuals.window) == {0, 1, 2, 3}


def test_a_predictor_that_runs_away_is_far_off_and_no_number_is_lost(monitor):
    away = replace(recorded(machine(), 2), observations=np.full((401, 2), 1e200))
    _, seen = monitor.follow(monitor.begin(), Nominal(PLANT), away)
    assert seen.alarms.keys() >= {"quantile_run", "likelihood_ratio_cusum"}
    assert np.isfinite(seen.rms).all()


def test_blocks_are_whole_windows_of_one_episode(monitor):
    residuals = monitor.healthy.residuals(
        unscaled_residuals(Nominal(PLANT), recorded(machine(), 3, seconds=11.0))
    )
    parts = blocks(replace(residuals, evidence=np.zeros((residuals.windows, 2, 2))), 2)
    assert [p.windows for p in parts] == [2] * (residuals.windows // 2)
    assert all(p.evidence.shape == (2, 2, 2) for p in parts)


def test_onset_is_where_errors_began_to_grow_whatever_the_other_channels_do():
    usual = [(0.0, 0.15)] * 4
    healthy = np.exp(np.random.default_rng(0).normal(0.0, 0.15, (300, 4)))
    grown = healthy.copy()
    grown[290:, 2] *= np.linspace(1.6, 3.0, 10)
    assert abs(onset(grown, usual) - 290) <= 2
    assert onset(np.array([[1.0], [1.0]]), usual[:1]) == 1


def test_an_episode_too_short_for_a_rollout_is_refused_and_no_reference(reference):
    positions = plant_of(BENCH, velocity=False)

    def cut(e, n):
        parts = {
            "observations": e.observations[:n, :1].copy(),
            "commands": e.commands[:n].copy(),
            "t_s": e.t_s[:n].copy(),
        }
        return replace(e, layout=positions.layout, **parts)

    with pytest.raises(NotIdentifiable, match="too few"):
        calibrate(Nominal(positions), "served", [cut(e, 5) for e in reference[:20]], 1.0)
    made = calibrate(
        Nominal(positions),
        "served",
        [cut(e, None) for e in reference],
        1.0,
        kinds=("quantile_run",),
    )
    with pytest.raises(NotAnEpisode):
        made.follow(made.begin(), Nominal(positions), cut(reference[0], 5))


def test_what_changed_tells_the_machine_from_its_task(reference):
    before = Before.of(reference)
    now = replace(
        before,
        ranges={**before.ranges, "u": (-1.5, 1.5)},
        conditions={"stage": ["SIL"], "payload": ["2 kg"]},
        period_s=0.04,
    )
    change = changed(before, {"q": np.array([2.0, 2.0]), "v": np.array([1.0, 1.0])}, now)
    assert change["channels"]["q"]["error"] == pytest.approx(2.0)
    assert set(change["outside"]) == {"u"}
    assert change["conditions"] == {"payload": {"reference": [], "now": ["2 kg"]}}
    assert len(change["words"]) == 4
    quiet = changed(before, {"q": np.array([1.0])}, before)
    assert quiet["words"] == []
    assert Before.from_document(before.document()) == replace(
        before, conditions={k: tuple(v) for k, v in before.conditions.items()}
    )


def test_the_interval_of_a_count_is_garwoods():
    assert poisson_interval(0) == (0.0, pytest.approx(3.689, abs=1e-3))
    assert poisson_interval(5) == (pytest.approx(1.623, abs=1e-3), pytest.approx(11.668, abs=1e-3))
    assert poisson_interval(100) == (
        pytest.approx(81.36, abs=0.01),
        pytest.approx(121.63, abs=0.01),
    )


def test_every_detector_says_what_its_promise_rests_on_and_only_the_proven_one_claims_a_guarantee():
    assert [name for name, kind in detectors().items() if kind.guarantee] == ["conformal_test"]
    assert all(kind.rests_on for kind in detectors().values())
    assert "no guarantee" in detectors()["quantile_run"].rests_on
