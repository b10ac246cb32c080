"""Machines of the second simulator, as plants and episodes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.model.plant import Plant
from trueup.simulate.machine import Run
from trueup.simulate.noise import WHITE, NoiseModel
from trueup.simulate.trial import JointBench, SimulatedTrial, draw, draw_bench


def plant_of(bench: JointBench, *, velocity: bool = True) -> Plant:
    """Returns the plant of a bench, with or without the velocity among its observations."""
    parameters = {"k": bench.k, "c": bench.c, "b": bench.b}
    if bench.kind == "inertia":
        del parameters["k"]
    observations = [{"name": "q", "unit": "rad"}, {"name": "v", "unit": "rad/s"}]
    return Plant.from_document(
        {
            "name": "simulated",
            "nominal": {
                "family": bench.kind,
                "parameters": parameters,
                "timestep_s": bench.timestep_s,
            },
            "commands": [{"name": "u", "unit": "rad/s^2", "limits": [-bench.limit, bench.limit]}],
            "observations": observations if velocity else observations[:1],
            "envelope": {"q": [-5.0, 5.0]},
            "evaluation": {"horizon_s": 2.0},
        }
    )


def episodes_of(plant: Plant, trial: SimulatedTrial, runs: int | None = None) -> list[Episode]:
    """Returns a trial's episodes: the first `runs` of each role, or all."""
    roles = Role.ADAPTATION, Role.VALIDATION
    return [
        episode_of(plant, run, role, f"{role}-{i}")
        for role in roles
        for i, run in enumerate(trial.of(role)[:runs])
    ]


def episode_of(plant: Plant, run: Run, role: Role, digest: str) -> Episode:
    """Returns one run of a machine as an episode."""
    observed = run.observed[:, : len(plant.layout.observations)].copy()
    return Episode(
        run.t_s.copy(),
        run.issued[:, None].copy(),
        observed,
        plant.layout,
        role,
        {"stage": "SIL"},
        0,
        digest,
    )


def recorded(
    tier: str,
    names: list[str],
    seed: int,
    *,
    shifted: bool = True,
    velocity: bool = True,
    law: NoiseModel = WHITE,
    runs: int | None = None,
) -> tuple[Plant, list[Episode], SimulatedTrial]:
    """Draws a machine of a tier with these effects, and records it.

    Returns its plant, its episodes, and the trial that holds the truth.
    """
    rng = np.random.default_rng(seed)
    bench = replace(draw_bench(tier, rng), law=law)
    trial = draw(bench, names, shifted, rng)
    plant = plant_of(bench, velocity=velocity)
    return plant, episodes_of(plant, trial, runs), trial


recorded_twice = partial(recorded, runs=2)  # enough to name an effect
