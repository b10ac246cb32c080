"""The chapter's plant and data, drawn from the chapter's seeds in its order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.fit.randomised import PooledTransitions, pooled
from trueup.model.plant import Plant
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.training import Draws, training_episodes
from trueup.simulate.excitation import smoothed_noise

Array = NDArray[np.float64]

DT_S = 0.05
U_MAX = 1.0
NOMINAL = (1.0, 0.4, 1.0)
DEPLOYMENT = (1.25, 0.62, 0.82)
SHIFTED = (1.85, 1.05, 0.70)
FAMILY = {
    "numbers": [
        {"number": "k", "distribution": "uniform", "low": 0.6, "high": 1.6},
        {"number": "c", "distribution": "uniform", "low": 0.2, "high": 0.8},
        {"number": "b", "distribution": "uniform", "low": 0.7, "high": 1.3},
    ]
}
DATA_SEED, TEST_SEED = 20240517, 999
DRAWS = Draws(plants=24, steps=160, start_scale=0.4)

PLANT = Plant.from_document(
    {
        "name": "chapter",
        "nominal": {
            "family": "oscillator",
            "parameters": dict(zip("kcb", NOMINAL, strict=True)),
            "timestep_s": DT_S,
            "integrator": "semi_implicit_euler",
        },
        "commands": [{"name": "u", "unit": "m/s^2", "limits": [-U_MAX, U_MAX]}],
        "observations": [
            {"name": "q", "unit": "m", "scale": 1.0},
            {"name": "v", "unit": "m/s", "scale": 1.0},
        ],
        "envelope": {"q": [-0.9, 0.9], "v": [-3.0, 3.0]},
        "evaluation": {"horizon_s": 2.0},
    }
)


@dataclass(frozen=True, slots=True)
class ChapterData:
    """All data that the chapter draws."""

    pooled: PooledTransitions
    adaptation: Episode
    validation: Episode
    mismatched: Episode
    test: Episode


def excitation(steps: int, rng: np.random.Generator) -> Array:
    """Smoothed noise within the command's limits, `(steps,)`."""
    return U_MAX * smoothed_noise(steps, rng)


def drive(parameters: tuple[float, ...], start: Array, issued: Array) -> Array:
    """States `(steps + 1, 2)` of a plant with these parameters, without noise."""
    states = np.empty((len(issued) + 1, 2))
    states[0] = start
    for t, u in enumerate(issued):
        states[t + 1] = PLANT.update(states[t : t + 1], np.array([[u]]), parameters)[0]
    return states


def recorded(
    parameters: tuple[float, ...],
    start: tuple[float, float],
    steps: int,
    rng: np.random.Generator,
    role: Role,
) -> Episode:
    """An episode of a plant with these parameters."""
    issued = excitation(steps, rng)
    states = drive(parameters, np.array(start), issued)
    held = np.append(issued, issued[-1])[:, None]
    return Episode(
        DT_S * np.arange(steps + 1, dtype=np.float64),
        held,
        states,
        PLANT.layout,
        role,
        {"stage": "MIL"},
        0,
        "",
    )


def draw() -> ChapterData:
    """One generator for training, adaptation, validation and mismatched episodes; another for the
    test episode."""
    rng = np.random.default_rng(DATA_SEED)
    pooled = _pool(rng)
    return ChapterData(
        pooled,
        recorded(DEPLOYMENT, (0.15, -0.05), 140, rng, Role.ADAPTATION),
        recorded(DEPLOYMENT, (-0.2, 0.1), 120, rng, Role.VALIDATION),
        recorded(SHIFTED, (0.0, 0.0), 140, rng, Role.ADAPTATION),
        recorded(DEPLOYMENT, (0.3, -0.2), 200, np.random.default_rng(TEST_SEED), Role.TEST),
    )


def _pool(rng: np.random.Generator) -> PooledTransitions:
    return pooled(PLANT, training_episodes(Randomisation.of(PLANT, FAMILY), DRAWS, rng))
