"""Predictors of a family from training episodes: where contexts come from, and what a wrong one
costs."""

import json
from dataclasses import replace

import numpy as np
import pytest

from trueup.chapter.data import DEPLOYMENT, DRAWS, FAMILY, PLANT, draw
from trueup.episode.role import Role
from trueup.errors import NotAnEpisode, NotIdentifiable, RoleRefused
from trueup.fit.randomised import (
    IDENTIFIED,
    RECORDED,
    context_cost,
    fit_blind,
    fit_conditioned,
    pooled,
    sample_box,
)
from trueup.model.plant import Plant
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.training import Draws, training_episodes


@pytest.fixture(scope="module")
def episodes():
    family = Randomisation.of(PLANT, FAMILY)
    return training_episodes(family, DRAWS, np.random.default_rng(1))


def without_context(episode):
    return replace(episode, conditions={"stage": "MIL"})


def test_contexts_are_those_recorded_else_identified_from_each_plants_own_episode(episodes):
    recorded = pooled(PLANT, episodes)
    identified = pooled(PLANT, [without_context(e) for e in episodes])
    assert (recorded.context, identified.context) == (RECORDED, IDENTIFIED)
    assert (recorded.plants, len(recorded.states)) == (24, 24 * 160)
    for name in "kcb":
        np.testing.assert_allclose(
            identified.parameters[name], recorded.parameters[name], rtol=1e-6
        )
    mixed = pooled(PLANT, [without_context(episodes[0]), *episodes[1:]])
    assert mixed.context == IDENTIFIED  # one source for all


def test_the_sample_box_is_what_was_drawn(episodes):
    drawn = [json.loads(e.conditions["context"]) for e in episodes]
    assert sample_box(pooled(PLANT, episodes)) == {
        name: (min(d[name] for d in drawn), max(d[name] for d in drawn)) for name in "kcb"
    }
    for declared in FAMILY["numbers"]:
        values = [d[declared["number"]] for d in drawn]
        assert declared["low"] <= min(values) < max(values) <= declared["high"]


def test_the_conditioned_map_holds_for_plants_it_was_not_fitted_on(episodes):
    data = pooled(PLANT, episodes)
    held_out = draw().validation
    right, blind = fit_conditioned(PLANT, data, DEPLOYMENT), fit_blind(PLANT, data)
    rolled = [m.run(held_out.observations[0], held_out.commands) for m in (right, blind)]
    errors = [np.abs(states - held_out.observations).max() for states in rolled]
    assert errors[0] < 1e-6
    assert errors[1] > 1e-2


def test_a_wrong_context_is_shown_for_what_it_costs(episodes):
    data = pooled(PLANT, episodes)
    model = fit_conditioned(PLANT, data, DEPLOYMENT)
    rows = {r["context"]: r for r in context_cost(model, sample_box(data), [draw().validation])}
    assert rows["as fitted"]["times"] == pytest.approx(1.0)
    assert len(rows) == 2 + 2 * 3
    wrong = [r["rollout"] for name, r in rows.items() if name != "as fitted"]
    assert min(wrong) > 1000.0 * rows["as fitted"]["rollout"]


def test_of_a_pendulum_the_products_are_its_own():
    document = {**PLANT.document, "nominal": {**PLANT.document["nominal"], "family": "pendulum"}}
    plant = Plant.from_document(document)
    family = Randomisation.of(plant, FAMILY)
    data = pooled(plant, training_episodes(family, Draws(12, 160), np.random.default_rng(0)))
    model = fit_conditioned(plant, data, DEPLOYMENT)
    assert model.map.features[-3:] == ("k*sin(q)", "c*v", "b*u")
    truth = plant.update(data.states[:50], data.issued[:50], DEPLOYMENT)
    predicted = model.predict_batch(data.states[:50], data.issued[:50])
    np.testing.assert_allclose(predicted, truth, atol=1e-6)


def test_training_data_of_another_role_or_without_sense_are_refused(episodes):
    with pytest.raises(RoleRefused):
        pooled(PLANT, [replace(episodes[0], role=Role.ADAPTATION)])
    with pytest.raises(NotIdentifiable, match="no training episode"):
        pooled(PLANT, [])
    huge, nested = '{"k": %s}' % ("9" * 400), "[" * 4000
    for text in ("k=1", "[1, 2]", '{"k": "soft"}', '{"k": NaN}', '{"k": true}', huge, nested):
        strange = replace(episodes[0], conditions={"context": text})
        with pytest.raises(NotAnEpisode, match="no JSON object of numbers"):
            pooled(PLANT, [strange])
