"""Training episodes: plants drawn from a family, each driven by a smoothed noise from a start that
chance says."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import BadRandomisation
from trueup.fit.randomised import CONTEXT
from trueup.model.plant import Plant
from trueup.randomise.randomisation import Randomisation
from trueup.simulate.excitation import smoothed_noise

Array = NDArray[np.float64]
MIL = "MIL"


@dataclass(frozen=True, slots=True)
class Draws:
    """How a family is drawn from: how many `plants`, how many `steps` each, and the standard
    deviation of the starting states in their reporting scales, `start_scale`."""

    plants: int = 24
    steps: int = 160
    start_scale: float = 0.4


def training_episodes(
    family: Randomisation,
    draws: Draws,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Episode]:
    """One episode of the role training of each drawn plant, without noise, which says its plant's
    numbers under its condition `context`.

    Every plant's numbers are drawn first, then for each plant its commands and its start. Raises
    BadRandomisation where a plant runs away.
    """
    numbers = [family.draw(rng) for _ in range(draws.plants)]
    episodes = []
    for count, values in enumerate(numbers, 1):
        episodes.append(_episode(family, values, draws, rng))
        progress(count / draws.plants)
    return episodes


def _episode(
    family: Randomisation, values: Mapping[str, float], draws: Draws, rng: np.random.Generator
) -> Episode:
    plant = family.plant
    issued = _commands(plant, draws.steps, rng)
    start = draws.start_scale * plant.state_scales * rng.standard_normal(2 * len(plant.joints))
    with np.errstate(over="ignore", invalid="ignore"):
        states = family.model(values).run(start, issued)
    if not np.isfinite(states).all():
        raise BadRandomisation(
            f"a plant with {', '.join(f'{n} = {v:.4g}' for n, v in values.items())} runs away "
            f"within {draws.steps} steps",
            field="numbers",
            hint="Narrow the family, or draw fewer steps.",
        )
    conditions = {"stage": MIL, CONTEXT: json.dumps(values)}
    t_s = np.asarray(plant.timestep_s * np.arange(draws.steps + 1), np.float64)
    return Episode(
        t_s, issued, plant.observe(states), plant.layout, Role.TRAINING, conditions, 0, ""
    )


def _commands(plant: Plant, steps: int, rng: np.random.Generator) -> Array:
    """Commands `(steps + 1, commands)` within the limits, the last one twice."""
    low, high = plant.limits
    shapes = np.stack([smoothed_noise(steps, rng) for _ in low], axis=1)
    issued = (low + high) / 2.0 + (high - low) / 2.0 * shapes
    return np.concatenate([issued, issued[-1:]])
