"""Draw a family, simulate it, fit the parameter-blind and the conditioned predictor, and say where
the deployment plant lies and what a wrong context costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isfinite

import numpy as np

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.errors import BadRandomisation, NotIdentifiable
from trueup.fit.identify import identify
from trueup.fit.randomised import (
    PooledTransitions,
    context_cost,
    fit_blind,
    fit_conditioned,
    pooled,
    sample_box,
)
from trueup.fit.score import EVERY, Scoring, score
from trueup.model.plant import Plant
from trueup.model.predictor import Blind, Conditioned, Nominal, Predictor
from trueup.randomise.membership import Box, box_document, membership
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.training import Draws, training_episodes

IDENTIFICATION, CONFIGURATION, MEASUREMENT = SOURCES = (
    "identification",
    "configuration",
    "measurement",
)
MOST_ROWS = 2_000_000  # transitions that are fitted at once: 500 MB of features for one joint


@dataclass(frozen=True, slots=True)
class Context:
    """Where the conditioned predictor's context comes from: identified from adaptation episodes,
    configured as plant.json declares, or measured, with its `measured` values by name."""

    by: str = IDENTIFICATION
    measured: Mapping[str, float] | None = None

    def parameters(self, plant: Plant, adaptation: Sequence[Episode]) -> dict[str, float]:
        """The parameters of the deployment plant by name; a measured one that is left out is
        nominal. Raises NotIdentifiable, BadRandomisation for an unknown name."""
        if self.by == IDENTIFICATION:
            if not adaptation:
                raise NotIdentifiable(
                    "there is no adaptation episode to identify the context from",
                    hint="Upload one, or give the context by configuration or by measurement.",
                )
            identified, _ = identify(plant, adaptation)
            return dict(zip(plant.dynamics.parameter_names, identified.parameters, strict=True))
        measured = dict(self.measured or {}) if self.by == MEASUREMENT else {}
        unknown = [name for name in measured if name not in plant.nominal]
        if unknown or (self.by == MEASUREMENT and not measured):
            what = f"{unknown[0]!r} is no parameter" if unknown else "nothing was measured"
            raise BadRandomisation(
                f"{what} of {plant.name}",
                field="context",
                hint=f"Parameters are {', '.join(plant.nominal)}.",
            )
        return {**plant.nominal, **measured}


@dataclass(frozen=True, slots=True)
class Randomised:
    """Both predictors of a family, and the document that says what they rest on."""

    blind: Blind
    conditioned: Conditioned
    document: Mapping[str, Json]


def randomise(
    family: Randomisation,
    draws: Draws,
    seed: int,
    context: Context,
    adaptation: Sequence[Episode] = (),
    progress: Callable[[str, float], None] = lambda _stage, _share: None,
) -> tuple[Randomised, list[Episode]]:
    """Draw, simulate and fit; returns the predictors, and the training episodes that they were
    fitted to.

    Raises BadRandomisation where the family is too large or runs away, NotIdentifiable without a
    context.
    """
    if draws.plants * draws.steps > MOST_ROWS:
        raise BadRandomisation(
            f"{draws.plants} plants of {draws.steps} steps are more than {MOST_ROWS} transitions",
            field="plants",
            hint="Draw fewer plants, or fewer steps.",
        )
    deployment = context.parameters(family.plant, adaptation)
    training = training_episodes(
        family, draws, np.random.default_rng(seed), lambda share: progress("simulating", share)
    )
    progress("fitting", 0.0)
    data = pooled(family.plant, training)
    fits = fit_family(family.plant, data, context, deployment, family.box(), adaptation)
    document = {
        **fits.document,
        "randomisation": dict(family.document),
        "draws": {**asdict(draws), "seed": seed},
    }
    progress("fitting", 1.0)
    return Randomised(fits.blind, fits.conditioned, document), training


def fit_family(
    plant: Plant,
    data: PooledTransitions,
    context: Context,
    deployment: Mapping[str, float],
    family_box: Box | None,
    adaptation: Sequence[Episode] = (),
) -> Randomised:
    """Both predictors from pooled transitions, as the document `trueup.randomise/1`."""
    blind = fit_blind(plant, data)
    conditioned = fit_conditioned(plant, data, [deployment[n] for n in plant.nominal])
    samples = sample_box(data)
    boxes: dict[str, Json] = {
        "family_box": None if family_box is None else box_document(family_box),
        "sample_box": box_document(samples),
    }
    inside: dict[str, Json] = {
        "family_box": None if family_box is None else membership(family_box, deployment),
        "sample_box": membership(samples, deployment),
    }
    models: Mapping[str, Predictor] = {
        "nominal": Nominal(plant),
        "blind": blind,
        "conditioned": conditioned,
    }
    document: dict[str, Json] = {
        "schema": "trueup.randomise/1",
        "plant": plant.name,
        "plants": data.plants,
        "rows": len(data.states),
        "features": {
            m: list(f.map.features) for m, f in (("blind", blind), ("conditioned", conditioned))
        },
        "training_context": data.context,
        "drawn": {name: sorted(set(map(float, x))) for name, x in data.parameters.items()},
        **boxes,
        "context": {"by": context.by, "parameters": dict(deployment)},
        "membership": inside,
        "errors": [_errors(name, m, adaptation) for name, m in models.items() if adaptation],
        "context_cost": context_cost(conditioned, samples, adaptation) if adaptation else [],
    }
    return Randomised(blind, conditioned, document)


def _errors(name: str, model: Predictor, episodes: Sequence[Episode]) -> dict[str, Json]:
    """A model's errors on adaptation episodes, in units of the channels' reporting scales."""
    scored = score(model, episodes, Scoring(model.plant.horizon_s, EVERY))
    pair = {"one_step": float(scored.one_step.mean()), "rollout": float(scored.rollout.mean())}
    return {"model": name, **{what: x if isfinite(x) else None for what, x in pair.items()}}
