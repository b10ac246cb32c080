"""The randomisation ranges that a diagnosis supports: its intervals, and each explanation that the
data could not tell apart as a kind of its own."""

import json

import numpy as np
import pytest

from tests.support.made import TRUE, corrected, plant_document
from trueup.model.plant import Plant
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.supported import supported_ranges

PLANT = Plant.from_document(plant_document())
FRICTION = corrected(PLANT, {"coulomb_friction": {"level": 0.2}}, TRUE)
DRAG = corrected(PLANT, {"quadratic_drag": {"coefficient": 0.3}}, TRUE)


def estimate(value, half):
    return {"value": value, "ci95": [value - half, value + half]}


def report(verdict="effect", alternatives=()):
    return {
        "plant": "bench-joint",
        "verdict": verdict,
        "parameters": {
            name: estimate(value, 0.05) for name, value in zip("kcb", TRUE, strict=True)
        },
        "effects": [{"effect": "coulomb_friction", "estimate": {"level": estimate(0.2, 0.02)}}],
        "evidence": {"alternatives": list(alternatives)},
    }


def test_every_interval_becomes_a_range():
    document = supported_ranges(FRICTION, report())
    family = Randomisation.of(PLANT, json.loads(json.dumps(document)))
    box = family.box()
    assert {name: pytest.approx(ends) for name, ends in box.items()} == {
        "k": (1.2, 1.3),
        "c": (0.57, 0.67),
        "b": (0.77, 0.87),
        "coulomb_friction.level": (0.18, 0.22),
    }
    model = family.model(family.draw(np.random.default_rng(0)))
    assert model.hypothesis.effects == ("coulomb_friction",)
    assert "95 % intervals" in document["because"]


def test_explanations_that_cannot_be_told_apart_are_kinds_of_their_own():
    other = {
        "model": DRAG.description(),
        "parameters": {name: estimate(v, 0.05) for name, v in zip("kcb", TRUE, strict=True)},
        "effects": [{"effect": "quadratic_drag", "estimate": {"coefficient": estimate(0.3, 0.1)}}],
    }
    document = supported_ranges(FRICTION, report(alternatives=[other]))
    family = Randomisation.of(PLANT, document)
    assert [set(kind.marginals) - set("kcb") for kind in family.kinds] == [
        {"coulomb_friction.level"},
        {"quadratic_drag.coefficient"},
    ]
    assert [kind.weight for kind in family.kinds] == [1.0, 1.0]
    assert "cannot tell apart" in document["because"]


def test_a_range_never_crosses_zero():
    wide = report()
    wide["effects"][0]["estimate"]["level"] = estimate(0.2, 0.5)
    family = Randomisation.of(PLANT, supported_ranges(FRICTION, wide))
    low, high = family.box()["coulomb_friction.level"]
    assert (low, high) == (0.0, pytest.approx(0.7))
    against = corrected(PLANT, {"constant_force": {"level": -0.2}}, TRUE)
    pushed = {"effect": "constant_force", "estimate": {"level": estimate(-0.2, 0.5)}}
    family = Randomisation.of(PLANT, supported_ranges(against, {**wide, "effects": [pushed]}))
    assert family.box()["constant_force.level"] == (pytest.approx(-0.7), 0.0)


def test_an_unexplained_gap_is_said_and_nothing_without_an_interval_is_made_up():
    assert "do not cover" in supported_ranges(FRICTION, report("unknown_effect"))["because"]
    nothing = {**report("no_gap"), "parameters": {}, "effects": []}
    assert supported_ranges(corrected(PLANT, {}, TRUE), nothing) is None


def with_ties(*pairs):
    document = report()
    document["evidence"]["correlations"] = [list(pair) for pair in pairs]
    return supported_ranges(FRICTION, document)


def test_numbers_that_are_off_together_are_drawn_together():
    document = with_ties(("k", "b", 0.95), ("c", "coulomb_friction.level", -0.6), ("k", "x", 0.9))
    assert document["correlation"] == [["k", "b", 0.95], ["c", "coulomb_friction.level", -0.6]]
    family = Randomisation.of(PLANT, json.loads(json.dumps(document)))
    rng = np.random.default_rng(0)
    drawn = [family.draw(rng) for _ in range(400)]
    k, b, c, level = (
        np.array([d[name] for d in drawn]) for name in ("k", "b", "c", "coulomb_friction.level")
    )
    assert np.corrcoef(k, b)[0, 1] > 0.9
    assert np.corrcoef(c, level)[0, 1] < -0.4
    assert abs(np.corrcoef(k, c)[0, 1]) < 0.15


def test_correlations_that_rounding_made_impossible_are_made_weaker():
    document = with_ties(("k", "c", 0.999), ("c", "b", 0.999), ("k", "b", 0.99))
    family = Randomisation.of(PLANT, json.loads(json.dumps(document)))
    assert all(0.9 < value < 1.0 for _, _, value in document["correlation"])
    family.draw(np.random.default_rng(0))
