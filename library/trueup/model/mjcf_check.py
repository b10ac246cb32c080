"""MJCF check: a written file run in MuJoCo, beside the model that it was written from, on the same
commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.layout import Channel, Field
from trueup.errors import NotExportable
from trueup.model.mjcf import mujoco
from trueup.model.mjcf_drive import actuator_of, motor_of
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor

Array = NDArray[np.float64]
DURATION_S, REACH, SMOOTH_S = 3.0, 0.5, 0.2  # of the commands; REACH of their limits


@dataclass(frozen=True, slots=True)
class Difference:
    """By how much MuJoCo's run of a file differs from the model's own, of one observation: both
    root mean squares in its unit, of the difference and of the motion."""

    channel: str
    unit: str
    rms: float
    motion: float

    @property
    def share(self) -> float:
        """The difference as a share of the motion."""
        return self.rms / self.motion if self.motion else 0.0

    def document(self) -> dict[str, Json]:
        """The difference as JSON."""
        return {
            "observation": self.channel,
            "unit": self.unit,
            "rms": self.rms,
            "motion": self.motion,
        }


def differences(path: Path, predictor: Predictor, seed: int = 0) -> tuple[Difference, ...]:
    """What MuJoCo makes of a written file, beside the model, under smooth commands within their
    limits, from the model's zero position at rest. Raises NotExportable where the file is not of
    the model's joints, NotInstalled without MuJoCo."""
    engine, plant = mujoco(), predictor.plant
    model = engine.MjModel.from_xml_path(str(path))
    commands = _commands(plant, seed)
    start = np.zeros(2 * len(plant.joints))
    columns = [_joint(engine, model, plant, c) for c in plant.layout.observations]
    for c, at in zip(plant.layout.observations, columns, strict=True):
        if c.field is Field.POSITION:
            start[plant.joint_of(c)] = model.qpos0[model.jnt_qposadr[at]]
    own = plant.observe(predictor.run(start, commands))
    theirs = _run(engine, model, plant, commands, columns)
    return tuple(
        Difference(
            c.name,
            c.unit,
            float(np.sqrt(np.mean((theirs[:, i] - own[:, i]) ** 2))),
            float(np.std(own[:, i])),
        )
        for i, c in enumerate(plant.layout.observations)
    )


def _commands(plant: Plant, seed: int) -> Array:
    """Smooth commands `(samples, commands)` about the middle of their limits."""
    samples = round(DURATION_S / plant.timestep_s)
    width = max(1, round(SMOOTH_S / plant.timestep_s))
    noise = np.random.default_rng(seed).normal(size=(samples + width, len(plant.layout.commands)))
    smooth = np.array([np.convolve(n, np.ones(width) / width, "valid") for n in noise.T]).T
    low, high = plant.limits
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    largest = np.abs(smooth).max(axis=0)
    return np.asarray(middle + REACH * half * smooth[:samples] / largest)


def _joint(engine: Any, model: Any, plant: Plant, channel: Channel) -> int:
    """The number of a channel's joint in a compiled file."""
    name = channel.joint or plant.joint_name(plant.joint_of(channel))
    at = int(engine.mj_name2id(model, engine.mjtObj.mjOBJ_JOINT, name))
    if at < 0 and model.njnt == 1:
        return 0
    if at < 0:
        raise NotExportable(f"the file has no joint {name}")
    return at


def _actuator(engine: Any, model: Any, plant: Plant, channel: Channel) -> int:
    """The number of the actuator that a channel commands: at its joint, or at its motor's."""
    at = _joint(engine, model, plant, channel)
    motor = motor_of(model.joint(at).name)
    beside = int(engine.mj_name2id(model, engine.mjtObj.mjOBJ_JOINT, motor))
    return actuator_of(model, beside if beside >= 0 else at)


def _run(engine: Any, model: Any, plant: Plant, commands: Array, columns: Sequence[int]) -> Array:
    """The observations of MuJoCo's run, `(samples, observations)`."""
    data = engine.MjData(model)
    parts = max(1, round(plant.timestep_s / model.opt.timestep))
    driven = [_actuator(engine, model, plant, c) for c in plant.layout.commands]
    for value, at in zip(commands[0], driven, strict=True):
        if model.actuator_actnum[at]:  # a lag, or a limited rate, begins at the first command
            data.act[model.actuator_actadr[at]] = value
    seen = np.empty((len(commands), len(columns)))
    for k, command in enumerate(commands):
        for i, (channel, at) in enumerate(zip(plant.layout.observations, columns, strict=True)):
            is_position = channel.field is Field.POSITION
            seen[k, i] = (
                data.qpos[model.jnt_qposadr[at]] if is_position else data.qvel[model.jnt_dofadr[at]]
            )
        for value, at in zip(command, driven, strict=True):
            data.ctrl[at] = value
        for _ in range(parts):
            engine.mj_step(model, data)
    return seen
