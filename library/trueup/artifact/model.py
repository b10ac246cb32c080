"""Model: a fetched artifact, ready to predict.

    model = trueup.load("model")                                   # what `trueup fetch` wrote,
                                                                   every byte verified
    path = model.rollout({"position": 0.1}, commands)              # from a start, on commands alone
    predicted = model.predict(t_s, commands, observed, horizon_s=2.0)  # of a recording, window by
                                                                       window

A rollout of one joint is plain numpy; that of a robot, and predicting a recording, compile their
kernel at the first call.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import singledispatch
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.artifact.artifact import Artifact, unpack
from trueup.episode.episode import Episode
from trueup.episode.layout import Channel
from trueup.episode.role import Role
from trueup.errors import BadArtifact
from trueup.model.dynamics import CompiledFamily, Dynamics
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor, predict_episode
from trueup.model.step_function import StepFunction

Array = NDArray[np.float64]
TWO = 2
MANIFEST, ARRAYS = "manifest.json", "arrays.safetensors"


@dataclass(frozen=True)
class Model:
    """A predictor with the digest that names it."""

    predictor: Predictor
    digest: str

    @property
    def plant(self) -> Plant:
        """The plant as it was declared."""
        return self.predictor.plant

    @property
    def observations(self) -> tuple[Channel, ...]:
        """Names of the predicted observations, in the order of columns."""
        return self.plant.layout.observations

    @property
    def commands(self) -> tuple[Channel, ...]:
        """Names of the commands, in the order of columns."""
        return self.plant.layout.commands

    @property
    def period_s(self) -> float:
        """The declared time between samples [s]."""
        return self.plant.timestep_s

    def rollout(self, start: Mapping[str, float], commands: ArrayLike) -> Array:
        """Observations `(samples, observations)` from a start, under commands `(samples, commands)`
        held for a period each.

        `start` gives, by the name of its observation, what is truly so, and 0 where it gives
        nothing; sample 0 is what the sensors say of it, before its command has acted. Of one joint
        also many at once: commands `(n, samples, commands)` give `(n, samples, observations)`. A
        single command may be left without its last axis. Raises ValueError for a name or a shape
        that does not fit, or without a sample.
        """
        issued, state = self._issued(commands), np.zeros(2 * self.plant.dynamics.joints)
        columns = {
            c.name: int(column)
            for c, column in zip(self.observations, self.plant.state_columns, strict=True)
        }
        for name, x in start.items():
            if name not in columns:
                raise ValueError(
                    f"there is no observation {name!r}: this model has {', '.join(columns)}"
                )
            state[columns[name]] = x
        predicted = _rolled(self.plant.dynamics, self, state, issued)
        return predicted if np.ndim(commands) == 3 else predicted[0]  # noqa: PLR2004

    def predict(
        self,
        t_s: ArrayLike,
        commands: ArrayLike,
        observed: ArrayLike,
        horizon_s: float | None = None,
    ) -> Array:
        """Predicted observations at every sample of a recording, `(samples, observations)`.

        Rollouts start at each multiple of the horizon [s], the declared one if None, from what the
        recording's past up to there tells. `t_s` `(samples,)` grows; `observed` `(samples,
        observations)` may hold nan. A single column may be left without its last axis. Raises
        ValueError for what does not fit.
        """
        t, layout = np.array(t_s, float), self.plant.layout
        if t.ndim != 1 or len(t) < TWO or not np.isfinite(t).all() or not (np.diff(t) > 0.0).all():
            raise ValueError("t_s are two or more finite times, each after the one before")
        if horizon_s is not None and not (np.isfinite(horizon_s) and horizon_s > 0.0):
            raise ValueError(f"horizon_s is a positive time, this is {horizon_s}")
        columns = (
            _columns("commands", commands, len(t), len(layout.commands)),
            _columns("observed", observed, len(t), len(self.observations)),
        )
        episode = Episode(t - t[0], *columns, layout, Role.TEST, {}, 0, "")
        return predict_episode(self.predictor, episode, horizon_s)

    def _issued(self, commands: ArrayLike) -> Array:
        """Commands as `(n, samples, commands)`."""
        array, width = np.array(commands, float), len(self.commands)
        array = array[:, None] if array.ndim == 1 and width == 1 else array
        if array.ndim not in (2, 3) or array.shape[-1] != width or array.shape[-2] == 0:
            raise ValueError(
                f"commands are (samples, {width}) or (n, samples, {width}), these are {array.shape}"
            )
        return array if array.ndim == 3 else array[None]  # noqa: PLR2004


def _columns(what: str, values: ArrayLike, samples: int, width: int) -> Array:
    """Columns `(samples, width)`; a single one may be `(samples,)`."""
    array = np.array(values, float)
    array = array[:, None] if array.ndim == 1 and width == 1 else array
    if array.shape != (samples, width):
        raise ValueError(f"{what} are ({samples}, {width}), these are {array.shape}")
    return array


def load(folder: str | PathLike[str], digest: str | None = None) -> Model:
    """The model in a folder that `trueup fetch` wrote, after every digest and its probe were
    checked. Raises BadArtifact."""
    manifest, arrays = Path(folder) / MANIFEST, Path(folder) / ARRAYS
    if not manifest.is_file():
        raise BadArtifact(
            f"{folder} holds no {MANIFEST}",
            hint="Fetch a model with `trueup fetch PLANT FOLDER`.",
        )
    artifact = Artifact(manifest.read_bytes(), arrays.read_bytes() if arrays.is_file() else b"")
    return Model(unpack(artifact, digest), artifact.digest)


def save(artifact: Artifact, folder: Path) -> None:
    """Write an artifact as `load` reads it; the folder is made."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MANIFEST).write_bytes(artifact.manifest)
    (folder / ARRAYS).write_bytes(artifact.arrays)


@singledispatch
def _rolled(_: Dynamics, model: Model, state: Array, issued: Array) -> Array:
    """Observations from a state `(states,)` under many commands `(n, samples, commands)`."""
    return np.stack([model.plant.observe(model.predictor.run(state, one)) for one in issued])


@_rolled.register
def _rolled_joint(_: CompiledFamily, model: Model, state: Array, issued: Array) -> Array:
    step_function, many = StepFunction.of(model.predictor), len(issued)
    samples = []
    now = step_function.begin(
        [np.full(many, state[0])], [np.full(many, state[1])], [issued[:, 0, 0]]
    )
    # A model that runs away answers with inf or nan.
    with np.errstate(over="ignore", invalid="ignore"):
        for u in np.moveaxis(issued, 1, 0):
            seen, now = step_function.step(now, list(u.T))
            samples.append(np.stack(seen, axis=1))
    return np.stack(samples, axis=1)
