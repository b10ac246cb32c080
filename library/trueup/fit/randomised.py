"""Domain-randomised fits: predictors of a whole family of plants, from training episodes.

The parameter-blind predictor is one map for every plant. The parameter-conditioned one is fed the
plant's parameters, its *context*, which at work comes from identification, from configuration or
from a measurement. A wrong context costs accuracy; `context_cost` says how much.
Source: J. Tobin et al., "Domain Randomization", IROS 2017; W. Yu et al., "Preparing for the
Unknown", RSS 2017.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import BadPlant, NotAnEpisode, NotIdentifiable
from trueup.fit.identify import identify
from trueup.fit.least_squares import ridge
from trueup.fit.residual import RIDGE
from trueup.fit.score import EVERY, Scoring, score
from trueup.fit.transitions import transitions
from trueup.model.features import conditioned, design, polynomial
from trueup.model.fields import Reader
from trueup.model.plant import Plant
from trueup.model.predictor import Blind, Conditioned, LinearMap

Array = NDArray[np.float64]
CONTEXT = "context"  # the condition under which a training episode says its plant's numbers
RECORDED, IDENTIFIED = "recorded", "identified"


@dataclass(frozen=True, slots=True)
class PooledTransitions:
    """Single transitions of many plants over a declared step: states, next states `(n, states)`,
    issued `(n, commands)`, parameters `(n,)` by name; `context` is where the parameters come from,
    `plants` how many there are."""

    states: Array
    issued: Array
    after: Array
    parameters: Mapping[str, Array]
    plants: int = 0
    context: str = RECORDED


def pooled(plant: Plant, episodes: Sequence[Episode]) -> PooledTransitions:
    """The transitions of training episodes, each of one plant.

    The plant's parameters are those that every episode records under its condition `context`, a
    JSON object; where one records none, every plant is identified from its own episode. Raises
    RoleRefused, NotIdentifiable, NotAnEpisode for a context that is none.
    """
    if not episodes:
        raise NotIdentifiable(
            "there is no training episode",
            hint="Upload one of each plant, whose metadata says role = training.",
        )
    data = transitions(plant, episodes, Role.TRAINING)
    contexts = [_recorded(plant, e) for e in episodes]
    source = RECORDED if all(contexts) else IDENTIFIED
    known = [
        recorded if source == RECORDED and recorded else _identified(plant, episode)
        for recorded, episode in zip(contexts, episodes, strict=True)
    ]
    lengths = [last - first for first, last in data.bounds]
    names = plant.dynamics.parameter_names
    whole = plant.timestep_s / data.h_s[:, None]
    declared = np.where(whole == 1.0, data.after, data.states + whole * (data.after - data.states))
    return PooledTransitions(
        data.states,
        data.issued,
        declared,
        {name: np.repeat([context[name] for context in known], lengths) for name in names},
        len(episodes),
        source,
    )


def fit_blind(plant: Plant, data: PooledTransitions, penalty: float = RIDGE) -> Blind:
    """One ridge fit of the next state over all plants, which are not told apart."""
    features = polynomial(len(plant.joints), len(plant.layout.commands))
    rows = design(features, data.states, data.issued, {})
    return Blind(plant, LinearMap(features, ridge(rows, data.after, penalty)))


def fit_conditioned(
    plant: Plant, data: PooledTransitions, context: Sequence[float], penalty: float = RIDGE
) -> Conditioned:
    """A ridge fit with the plants' parameters among the features; at work it is fed a `context`, in
    the order of the plant's parameters."""
    features = conditioned(plant.dynamics, len(plant.layout.commands))
    rows = design(features, data.states, data.issued, data.parameters)
    return Conditioned(plant, LinearMap(features, ridge(rows, data.after, penalty)), tuple(context))


def sample_box(data: PooledTransitions) -> dict[str, tuple[float, float]]:
    """The observed range of each parameter over the pooled plants."""
    return {
        name: (float(np.min(values)), float(np.max(values)))
        for name, values in data.parameters.items()
    }


def context_cost(
    model: Conditioned,
    box: Mapping[str, tuple[float, float]],
    episodes: Sequence[Episode],
) -> list[Json]:
    """What a wrong context costs: the model's error on episodes with its own context, with the
    nominal parameters, and with each parameter at either end of a box, and how many times its own
    error that is."""
    plant = model.plant
    names = plant.dynamics.parameter_names
    wrong = {"as fitted": model.parameters, "nominal": plant.parameters}
    for i, name in enumerate(names):
        for end in box.get(name, ()):
            other = (*model.parameters[:i], end, *model.parameters[i + 1 :])
            wrong[f"{name} = {end:.4g}"] = other
    rows: list[Json] = []
    own = float("nan")
    for label, context in wrong.items():
        scored = score(
            replace(model, parameters=context), episodes, Scoring(plant.horizon_s, EVERY)
        )
        rollout, one_step = float(scored.rollout.mean()), float(scored.one_step.mean())
        own = rollout if not rows else own
        times = rollout / own if own > 0.0 else float("nan")
        rows.append(
            {
                "context": label,
                "one_step": one_step if isfinite(one_step) else None,
                "rollout": rollout if isfinite(rollout) else None,
                "times": times if isfinite(times) else None,
            }
        )
    return rows


def _recorded(plant: Plant, episode: Episode) -> dict[str, float] | None:
    """The parameters that a training episode records, None where it records none; what it leaves
    out is nominal. Raises NotAnEpisode."""
    text = episode.conditions.get(CONTEXT)
    if text is None:
        return None
    try:
        given = Reader.of_text(text, CONTEXT).every_number()
    except BadPlant as error:
        raise NotAnEpisode(
            f"the context of training episode {episode.digest[:12]} is no JSON object of numbers: "
            f"{error.message}",
            rule="context",
            digest=episode.digest,
        ) from error
    return {**plant.nominal, **{n: x for n, x in given.items() if n in plant.nominal}}


def _identified(plant: Plant, episode: Episode) -> dict[str, float]:
    """A training plant's parameters, identified from its own episode."""
    predictor, _ = identify(plant, [replace(episode, role=Role.ADAPTATION)])
    return dict(zip(plant.dynamics.parameter_names, predictor.parameters, strict=True))
