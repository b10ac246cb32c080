"""Synthetic plants, episodes and artifacts for tests."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from trueup.artifact.artifact import Artifact, pack
from trueup.episode.layout import Channel, Field, Layout
from trueup.episode.role import Role
from trueup.episode.writer import Encoding, write_episode
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.predictor import Identified
from trueup.model.series import DECLARED, Scheme

T0_NS = 1_760_000_000_000_000_000
TRUE = (1.25, 0.62, 0.82)  # k, c, b of the machine that the episodes come from


def plant_document(name: str = "bench-joint") -> dict:
    """Returns the plant.json of an oscillator, whose nominal numbers are not TRUE."""
    return {
        "name": name,
        "nominal": {
            "family": "oscillator",
            "parameters": {"k": 1.0, "c": 0.4, "b": 1.0},
            "timestep_s": 0.05,
            "integrator": "semi_implicit_euler",
        },
        "commands": [{"name": "u", "unit": "m/s^2", "limits": [-1.0, 1.0]}],
        "observations": [
            {"name": "q", "unit": "m", "scale": 1.0},
            {"name": "v", "unit": "m/s", "scale": 1.0},
        ],
        "envelope": {"q": [-0.9, 0.9], "v": [-3.0, 3.0]},
        "evaluation": {"horizon_s": 2.0},
        "topics": {"observation": "/joint_states", "command": "/joint_commands"},
    }


def identified(name: str, k: float = 1.2) -> Artifact:
    """Returns an artifact with other numbers in the nominal form, as a user would upload it."""
    return pack(
        Identified(Plant.from_document(plant_document(name)), (k, 0.6, 0.8)), {"origin": "test"}
    )


def corrected(
    plant: Plant,
    effects: Mapping[str, Mapping[str, float]],
    parameters: Sequence[float] | None = None,
    scheme: Scheme = DECLARED,
) -> Corrected:
    """Returns a model with the parameters of these terms, and of the nominal form if other ones are
    given."""
    values, hypothesis = plant.block.nulls.copy(), Hypothesis()
    nominal = plant.parameters if parameters is None else parameters
    values[: len(nominal)] = nominal
    for of, numbers in effects.items():
        hypothesis, rows = hypothesis | of, plant.block.rows_of(of)
        for number, value in numbers.items():
            values[rows[number]] = value
    return Corrected(plant, hypothesis, tuple(map(float, values)), scheme)


def arm_layout(joints: int) -> Layout:
    """Returns a layout with positions, velocities and efforts of several joints."""
    names = [f"j{i}" for i in range(joints)]
    observations = [Channel(f"q{n}", "rad", Field.POSITION, n) for n in names] + [
        Channel(f"v{n}", "rad/s", Field.VELOCITY, n) for n in names
    ]
    return Layout(
        tuple(observations), tuple(Channel(f"u{n}", "N·m", Field.EFFORT, n) for n in names)
    )


def episode_bytes(
    seed: int = 0,
    samples: int = 200,
    role: Role = Role.ADAPTATION,
    parameters: tuple[float, ...] = TRUE,
    encoding: Encoding = Encoding.CDR,
    **conditions: str,
) -> bytes:
    """Returns an excited run of an oscillator with these parameters, without noise, as MCAP."""
    plant, rng = Plant.from_document(plant_document()), np.random.default_rng(seed)
    issued = np.clip(np.convolve(rng.normal(size=samples), np.ones(8) / 4, "same"), -1.0, 1.0)[
        :, None
    ]
    states = np.empty((samples, 2))
    states[0] = rng.normal(scale=0.3, size=2)
    for i in range(samples - 1):
        states[i + 1] = plant.update(states[i : i + 1], issued[i : i + 1], parameters)[0]
    return mcap_bytes(
        plant.layout,
        states,
        issued,
        role=role,
        encoding=encoding,
        start_ns=T0_NS + seed * 10**12,
        **conditions,
    )


def mcap_bytes(
    layout: Layout,
    observations: np.ndarray,
    commands: np.ndarray,
    *,
    role: Role = Role.ADAPTATION,
    encoding: Encoding = Encoding.CDR,
    start_ns: int = T0_NS,
    stamps_ns: np.ndarray | None = None,
    **conditions: str,
) -> bytes:
    """Returns an episode as MCAP, sampled every 50 ms unless it has stamps."""
    stream = io.BytesIO()
    stamps = (
        start_ns + np.arange(len(observations)) * 50_000_000 if stamps_ns is None else stamps_ns
    )
    write_episode(
        stream,
        stamps_ns=stamps,
        observations=observations,
        commands=commands,
        layout=layout,
        role=role,
        conditions=conditions,
        encoding=encoding,
    )
    return stream.getvalue()


def save(folder: Path, name: str, data: bytes) -> Path:
    """Writes a file, and returns its path."""
    path = folder / name
    path.write_bytes(data)
    return path
