"""Families of plants as data: what is drawn has the declared distributions, ties and bounds, and a
family that breaks a rule is refused at its field."""

import json

import numpy as np
import pytest
from scipy import stats

from tests.support.made import plant_document
from tests.support.robots import arm_plant
from trueup.canonical import canonical_bytes
from trueup.chapter.data import DRAWS, FAMILY, PLANT
from trueup.errors import BadRandomisation
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.model.predictor import Identified
from trueup.randomise.membership import box_document, box_of_document, membership
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.training import Draws, training_episodes

UNIFORM = {"distribution": "uniform", "low": 0.5, "high": 1.5}
MANY = 4000


def listed(numbers):
    return [{"number": name, **marginal} for name, marginal in numbers.items()]


def family(numbers, **more):
    return Randomisation.of(PLANT, {"numbers": listed(numbers), **more})


def drawn(of, count=MANY, seed=0):
    rng = np.random.default_rng(seed)
    return [of.draw(rng) for _ in range(count)]


@pytest.mark.parametrize(
    ("marginal", "same"),
    [
        (UNIFORM, stats.uniform(0.5, 1.0)),
        ({"distribution": "norm", "loc": 1.0, "scale": 0.1}, stats.norm(1.0, 0.1)),
        ({"distribution": "lognorm", "s": 0.4, "scale": 0.9}, stats.lognorm(0.4, scale=0.9)),
        ({"distribution": "t", "df": 3.0, "loc": 1.0, "scale": 0.1}, stats.t(3.0, 1.0, 0.1)),
        ({"distribution": "cauchy", "loc": 1.0, "scale": 0.05}, stats.cauchy(1.0, 0.05)),
        ({"distribution": "genpareto", "c": 0.3, "loc": 0.1}, stats.genpareto(0.3, 0.1)),
    ],
)
def test_draws_have_the_declared_distribution(marginal, same):
    values = [d["k"] for d in drawn(family({"k": marginal}))]
    assert stats.kstest(values, same.cdf).pvalue > 0.01


def test_a_heavy_tail_can_be_cut_off():
    cut = {"distribution": "cauchy", "loc": 1.0, "scale": 0.2, "low": 0.5, "high": 3.0}
    of = family({"k": cut})
    values = np.array([d["k"] for d in drawn(of)])
    assert 0.5 <= values.min() < values.max() <= 3.0
    whole = stats.cauchy(1.0, 0.2)
    kept = (whole.cdf(values) - whole.cdf(0.5)) / (whole.cdf(3.0) - whole.cdf(0.5))
    assert stats.kstest(kept, "uniform").pvalue > 0.01
    assert of.box() == {"k": (pytest.approx(0.5), pytest.approx(3.0))}


@pytest.mark.slow
def test_correlated_numbers_keep_their_distributions():
    lognormal = {"distribution": "lognorm", "s": 0.3}
    of = family({"k": UNIFORM, "c": lognormal, "b": UNIFORM}, correlation=[["k", "c", 0.8]])
    values = {name: [d[name] for d in drawn(of)] for name in "kcb"}
    assert stats.kstest(values["k"], stats.uniform(0.5, 1.0).cdf).pvalue > 0.01
    assert stats.kstest(values["c"], stats.lognorm(0.3).cdf).pvalue > 0.01
    # of a Gaussian copula the rank correlation is 6/pi asin(rho/2)
    expected = 6.0 / np.pi * np.arcsin(0.4)
    assert stats.spearmanr(values["k"], values["c"]).statistic == pytest.approx(expected, abs=0.03)
    assert abs(stats.spearmanr(values["k"], values["b"]).statistic) < 0.05


def test_a_mixture_draws_each_kind_by_its_weight_and_its_box_spans_all():
    of = Randomisation.of(
        PLANT,
        {
            "mixture": [
                {"weight": 3.0, "numbers": listed({"k": UNIFORM})},
                {
                    "weight": 1.0,
                    "numbers": listed(
                        {"coulomb_friction.level": {**UNIFORM, "low": 0.1, "high": 0.2}}
                    ),
                },
            ]
        },
    )
    values = drawn(of)
    assert np.mean(["k" in d for d in values]) == pytest.approx(0.75, abs=0.03)
    assert of.names == ("k", "coulomb_friction.level")
    assert of.box() == {"k": (0.5, 1.5), "coulomb_friction.level": (0.0, 0.2)}
    rubbing = next(d for d in values if "k" not in d)
    model = of.model(rubbing)
    assert isinstance(model, Corrected)
    assert model.hypothesis.effects == ("coulomb_friction",)
    assert model.values[: len(PLANT.parameters)] == PLANT.parameters


def test_an_unbounded_number_has_the_box_of_almost_all_draws():
    of = family({"k": {"distribution": "norm", "loc": 1.0, "scale": 0.1}})
    low, high = of.box(0.99)["k"]
    assert (low, high) == pytest.approx(tuple(stats.norm(1.0, 0.1).interval(0.99)))


def test_the_numbers_of_a_robots_effects_name_their_joint(tmp_path):
    arm = arm_plant(tmp_path)
    level = {"distribution": "uniform", "low": 1.0, "high": 2.0}
    of = Randomisation.of(arm, {"numbers": listed({"coulomb_friction@elbow.level": level})})
    assert of.model({"coulomb_friction@elbow.level": 1.5}).hypothesis.effects == (
        "coulomb_friction@1",
    )
    with pytest.raises(BadRandomisation, match="neither a parameter"):
        Randomisation.of(arm, {"numbers": listed({"coulomb_friction.level": level})})


REFUSED = [
    ({}, "numbers"),
    ({"numbers": []}, "numbers"),
    ({"numbers": {"k": UNIFORM}}, "numbers"),
    ({"numbers": listed({"stiffness": UNIFORM})}, "numbers[0].number"),
    ({"numbers": listed({"friction.level": UNIFORM})}, "numbers[0].number"),
    ({"numbers": listed({"k": UNIFORM, "coulomb_friction.x": UNIFORM})}, "numbers[1].number"),
    ({"numbers": listed({"k": UNIFORM}) * 2}, "numbers[1].number"),
    ({"numbers": listed({"k": {"distribution": "dirac"}})}, "numbers[0].distribution"),
    ({"numbers": listed({"k": {**UNIFORM, "high": 0.5}})}, "numbers[0]"),
    ({"numbers": listed({"k": {**UNIFORM, "loc": 1.0}})}, "numbers[0].loc"),
    ({"numbers": listed({"k": {"distribution": "lognorm"}})}, "numbers[0].s"),
    ({"numbers": listed({"k": {"distribution": "lognorm", "s": -1.0}})}, "numbers[0]"),
    ({"numbers": listed({"k": {"distribution": "norm", "scale": 0.0}})}, "numbers[0].scale"),
    ({"numbers": listed({"k": {"distribution": "norm", "low": 50, "high": 60}})}, "numbers[0]"),
    ({"numbers": listed({"k": UNIFORM}), "correlation": [["k", "c", 0.5]]}, "correlation"),
    (
        {"numbers": listed({"k": UNIFORM, "c": UNIFORM}), "correlation": [["k", "c", 2]]},
        "correlation",
    ),
    ({"numbers": listed({"k": UNIFORM}), "correlation": "strong"}, "correlation"),
    ({"mixture": [{"weight": 0.0, "numbers": listed({"k": UNIFORM})}]}, "mixture[0].weight"),
    ({"numbers": listed({"k": UNIFORM}), "mixture": []}, "numbers"),
    ({"schema": "trueup.randomisation/2", "numbers": listed({"k": UNIFORM})}, "schema"),
]


@pytest.mark.parametrize(("document", "field"), REFUSED)
def test_what_is_no_family_is_refused_at_its_field(document, field):
    with pytest.raises(BadRandomisation) as refused:
        Randomisation.of(PLANT, document)
    assert refused.value.facts["field"] == field
    assert refused.value.hint


def test_ties_that_cannot_be_are_refused():
    three = {"k": UNIFORM, "c": UNIFORM, "b": UNIFORM}
    ties = [["k", "c", 0.9], ["c", "b", 0.9], ["k", "b", -0.9]]
    with pytest.raises(BadRandomisation, match="positive semidefinite"):
        family(three, correlation=ties)


def test_a_family_that_was_written_down_canonically_draws_the_same_plants():
    of = Randomisation.of(PLANT, FAMILY)
    again = Randomisation.of(PLANT, json.loads(canonical_bytes(FAMILY)))
    assert drawn(again, 5) == drawn(of, 5)


def test_a_box_tells_inside_outside_and_not_known():
    box = {"k": (0.6, 1.6), "c": (0.2, 0.8)}
    inside = membership(box, {"k": 1.6, "c": 0.3})
    assert inside["inside"] is True
    outside = membership(box, {"k": 1.7})
    assert outside["inside"] is False
    assert outside["numbers"]["k"] == {"low": 0.6, "high": 1.6, "value": 1.7, "inside": False}
    assert membership(box, {"k": 1.0})["inside"] is None
    assert box_of_document(json.loads(json.dumps(box_document(box)))) == box


def test_training_episodes_are_the_chapters_and_say_their_plants_numbers():
    episodes = training_episodes(
        Randomisation.of(PLANT, FAMILY), DRAWS, np.random.default_rng(20240517)
    )
    assert len(episodes) == 24
    assert {len(e.t_s) for e in episodes} == {161}
    context = json.loads(episodes[0].conditions["context"])
    rng = np.random.default_rng(20240517)
    assert context == {
        name: rng.uniform(low, high)
        for name, low, high in (("k", 0.6, 1.6), ("c", 0.2, 0.8), ("b", 0.7, 1.3))
    }
    truth = Identified(PLANT, (context["k"], context["c"], context["b"]))
    np.testing.assert_allclose(
        episodes[0].observations, truth.run(episodes[0].observations[0], episodes[0].commands)
    )


def test_commands_stay_within_lopsided_limits():
    document = plant_document()
    document["commands"][0]["limits"] = [0.0, 3.0]
    plant = Plant.from_document(document)
    of = Randomisation.of(plant, {"numbers": listed({"k": UNIFORM})})
    (episode,) = training_episodes(of, Draws(1, 400), np.random.default_rng(0))
    assert 0.0 <= episode.commands.min() < 1.0
    assert 2.0 < episode.commands.max() <= 3.0


def test_a_plant_that_runs_away_is_refused_with_its_numbers():
    wild = family({"k": {"distribution": "uniform", "low": -1e9, "high": -1e8}})
    with pytest.raises(BadRandomisation, match=r"k = .* runs away"):
        training_episodes(wild, DRAWS, np.random.default_rng(0))
