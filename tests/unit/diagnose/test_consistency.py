"""Recordings of a machine whose friction changed from one day to the next: the study says so, a
diagnosis widens its interval by it, and recordings that agree change nothing."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.support import robots
from tests.support.robots import arm_plant
from trueup.diagnose.between_recordings import Agreement, Alone, Difference
from trueup.diagnose.consistency import consistency, groupings
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.summary_warnings import warnings
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.residual import fit_residual
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal
from trueup.model.series import DECLARED
from trueup_pages.consistency import names_of, report_page, sentence, view

LEVELS = 0.5, 0.62  # of the friction, on the first and on the second day
DAY_NS = 86_400 * 10**9
NOISE = 2e-3
SAMPLES = 2000
PLANT = Plant.from_document(
    {
        "name": "drifting",
        "nominal": {
            "family": "oscillator",
            "parameters": {"k": 9.0, "c": 0.4, "b": 1.0},
            "timestep_s": 0.01,
        },
        "commands": [{"name": "u", "unit": "rad/s^2", "limits": [-9.0, 9.0]}],
        "observations": [{"name": "q", "unit": "rad"}, {"name": "v", "unit": "rad/s"}],
        "evaluation": {"horizon_s": 1.0},
    }
)


def with_friction(level: float) -> Corrected:
    values = PLANT.block.nulls.copy()
    values[: len(PLANT.parameters)] = PLANT.parameters
    values[PLANT.block.rows_of("coulomb_friction")["level"]] = level
    return Corrected(PLANT, Hypothesis(("coulomb_friction",)), tuple(map(float, values)), DECLARED)


def recorded(level: float, seed: int, day: int, role: Role = Role.ADAPTATION) -> Episode:
    rng = np.random.default_rng(seed)
    t_s = np.arange(SAMPLES) * PLANT.timestep_s
    waves = zip(rng.uniform(1.0, 7.0, 4), rng.uniform(0.0, 6.3, 4), strict=True)
    issued = sum(1.6 * np.sin(w * t_s + phase) for w, phase in waves)[:, None]
    states = with_friction(level).run(np.array([0.2, 0.0]), issued)
    observed = states + NOISE * rng.standard_normal(states.shape)
    conditions = {"stage": "physical", "recording": f"run-{seed}"}
    digest = f"{seed:064x}"
    return Episode(t_s, issued, observed, PLANT.layout, role, conditions, day * DAY_NS, digest)


@pytest.fixture(scope="module")
def alike():
    return [recorded(LEVELS[0], seed, 1) for seed in range(4)]


@pytest.fixture(scope="module")
def drifted():
    return [recorded(LEVELS[seed // 3], seed, 1 + seed // 3) for seed in range(6)]


def number(document, parameter):
    return next(n for n in document["numbers"] if n["parameter"] == parameter)


def by(of, grouping):
    return next(b for b in of["by"] if b["grouping"] == grouping)


def test_the_variance_between_equally_certain_estimates_is_theirs_less_their_own():
    rng = np.random.default_rng(0)
    values, half = rng.normal(3.0, 2.0, 9), 0.7
    difference = Difference({str(i): Alone(v, half) for i, v in enumerate(values)})
    own = (half / 1.96) ** 2
    assert difference.deviation == pytest.approx(np.sqrt(values.var(ddof=1) - own))
    assert difference.mean == pytest.approx(values.mean())
    assert difference.q == pytest.approx(((values - values.mean()) ** 2).sum() / own)
    assert difference.half > 2.0 * difference.deviation  # Student's t of nine


def test_estimates_that_agree_widen_nothing():
    rng = np.random.default_rng(1)
    widens = 0
    for _ in range(200):
        halves = rng.uniform(0.5, 2.0, 5)
        values = rng.normal(0.0, halves / 1.96)
        pairs = zip(values, halves, strict=True)
        difference = Difference({str(i): Alone(v, h) for i, (v, h) in enumerate(pairs)})
        widens += difference.half > 0.0
    assert widens < 200 * 0.1  # one in twenty by chance


def test_recordings_are_parted_by_day_and_by_conditions_but_not_as_finely_as_they_are():
    loads = ("0 kg", "1 kg", "1 kg", "0 kg")
    episodes = [
        replace(e, conditions={**e.conditions, "load": load, "operator": "one"})
        for e, load in zip([recorded(0.5, s, 1 + s // 2) for s in range(4)], loads, strict=True)
    ]
    parted = {g.name: g.subsets for g in groupings(episodes)}
    assert list(parted) == ["recording", "day", "load"]
    assert list(parted["day"]) == ["1970-01-02", "1970-01-03"]
    assert parted["load"]["1 kg"] == [episodes[1].digest, episodes[2].digest]
    halves = groupings([recorded(0.5, s, 1) for s in range(5)])[1]
    assert {n: len(d) for n, d in halves.subsets.items()} == {"earlier": 3, "later": 2}


def test_a_condition_that_is_called_as_a_grouping_is_parts_nothing_twice():
    episodes = [
        replace(e, conditions={**e.conditions, "day": "1970-01-02", "half": str(i % 2)})
        for i, e in enumerate(recorded(0.5, s, 1 + s // 2) for s in range(4))
    ]
    parted = {g.name: g.subsets for g in groupings(episodes)}
    assert list(parted) == ["recording", "day"]
    assert sorted(d for digests in parted["day"].values() for d in digests) == sorted(
        e.digest for e in episodes
    )


def test_a_machine_that_changed_overnight_is_told_so(drifted):
    document = consistency(with_friction(0.56), drifted)
    level = number(document, "level")
    days = by(level, "day")
    assert days["contradicts"]
    assert set(days["apart"]) == {"1970-01-02", "1970-01-03"}
    for subset, true in zip(days["subsets"], LEVELS, strict=True):
        low, high = subset["ci95"]
        assert low < true < high
    assert by(level, "recording")["deviation"] == pytest.approx(0.06, rel=0.3)
    assert not by(number(document, "b"), "day")["contradicts"]
    told = sentence(document)
    assert "Coulomb friction (level)" in told
    assert "run-" in told or "1970-01" in told
    assert names_of(document)[drifted[0].digest] == "run-0"


def test_recordings_that_agree_are_told_so(alike):
    document = consistency(with_friction(0.56), alike)
    assert "agree on 4 numbers" in sentence(document)
    low, high = number(document, "level")["ci95"]
    assert low < LEVELS[0] < high


@pytest.mark.slow
def test_a_study_of_days_diagnoses_each_of_them(drifted):
    validation = [recorded(LEVELS[0], 9, 1, Role.VALIDATION)]
    document = consistency(with_friction(0.5), [*drifted, *validation], diagnoses=True)
    rows = [r for r in document["diagnoses"] if r["grouping"] == "day"]
    assert [r["subset"] for r in rows] == ["1970-01-02", "1970-01-03"]
    assert "coulomb_friction" in [e["effect"] for e in rows[0]["effects"]]
    shown = view(document)["diagnoses"][0]
    assert shown["of"] == "day 1970-01-02"
    assert "Coulomb friction" in shown["effects"]


def test_earlier_diagnoses_are_no_subsets(alike):
    document = consistency(with_friction(0.5), alike)
    rows = [
        {"grouping": "diagnosis", "subset": f"of 2026-01-0{i}", "verdict": verdict,
         "sentence": "So.", "effects": []}
        for i, verdict in enumerate(("no_gap", "parameters_only"), 1)
    ]  # fmt: skip
    with_earlier = {**document, "earlier": rows}
    assert sentence(with_earlier) == sentence(document)
    page = report_page(with_earlier)
    assert "Earlier diagnoses" in page
    assert "Diagnosed alone" not in page


def test_numbers_of_a_robot_are_compared_by_their_names(tmp_path):
    plant = arm_plant(tmp_path)
    roles = [Role.ADAPTATION, Role.ADAPTATION, Role.VALIDATION]
    episodes = robots.recorded(plant, lambda _: None, range(3), roles)
    document = consistency(Nominal(plant), episodes)
    compared = {n["parameter"] for n in document["numbers"] if n["by"]}
    assert compared
    assert "None of" not in sentence(document)


def test_the_page_shows_every_recording_and_no_markup_of_a_name(drifted):
    name = "<script>alert(1)</script>"
    document = consistency(with_friction(0.56), drifted, names={drifted[0].digest: name})
    page = report_page(document)
    assert name not in page
    assert "&lt;script&gt;" in page
    assert page.count("class=interval") >= 4 * 6


def test_what_has_no_parameters_or_too_few_recordings_is_refused(alike):
    residual, _ = fit_residual(PLANT, alike)
    with pytest.raises(NotIdentifiable, match="no parameters"):
        consistency(residual, alike)
    with pytest.raises(NotIdentifiable, match="two recordings"):
        consistency(with_friction(0.5), alike[:1])


@pytest.mark.slow
def test_a_diagnosis_of_recordings_that_differ_widens_its_interval_and_says_so(drifted, alike):
    held_out = partial(recorded, day=1, role=Role.VALIDATION)
    wide, narrow = (
        diagnose(PLANT, [*episodes, held_out(LEVELS[0], 7), held_out(LEVELS[0], 8)]).document
        for episodes in (drifted, alike)
    )
    levels = [
        next(b for b in report["between_recordings"] if b["parameter"] == "level")
        for report in (wide, narrow)
    ]
    assert [b["widens"] for b in levels] == [True, False]
    assert any("differ in" in w and "Coulomb friction (level)" in w for w in warnings(wide))
    assert not any("differ in" in w for w in warnings(narrow))
    (friction,) = (e for e in wide["effects"] if e["effect"] == "coulomb_friction")
    low, high = friction["estimate"]["level"]["ci95"]
    together = levels[0]["together"]
    assert high - low > 2.0 * (together[1] - together[0])
    assert low < LEVELS[0] < LEVELS[1] < high  # what one more recording would show
    (same,) = (e for e in narrow["effects"] if e["effect"] == "coulomb_friction")
    assert_allclose(same["estimate"]["level"]["ci95"], levels[1]["together"])


def test_a_number_that_one_recording_alone_determines_is_not_compared():
    assert Agreement().by_number == {}
    assert Agreement().wider == {}
