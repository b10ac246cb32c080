"""Predictors: the next state of a plant, behind one batched interface.

    nominal      the plant's own update with its nominal parameters
    identified   the same with identified parameters
    blind        a linear map of declared features, fitted over a family of plants
                 (domain-randomised, parameter-blind)
    conditioned  the same, also fed the identified parameters (domain-randomised,
                 parameter-conditioned)
    residual     nominal plus a linear map of declared features

Source of the domain-randomised pair: J. Tobin et al., "Domain Randomization", IROS 2017; W. Yu et
al., "Preparing for the Unknown", RSS 2017, for conditioning on identified parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.errors import BadArtifact
from trueup.model.features import design, known_features
from trueup.model.plant import Plant
from trueup.model.windows import Windows, cut, starts_every

Array = NDArray[np.float64]


class Predictor(ABC):
    """A belief about how a plant moves.

    `description` and `arrays` hold everything of it but the plant: `restore` makes the same
    predictor of them.
    """

    kind: ClassVar[str]
    plant: Plant

    @abstractmethod
    def predict_batch(
        self, states: Array, issued: Array, h_s: Array | float | None = None
    ) -> Array:
        """Next states `(n, states)`, of states `(n, states)` under issued commands `(n, commands)`.

        They are `h_s` [s] later, one length for all or `(n,)`; the declared step if None.
        """

    def hold(self, states: Array, issued: Array, steps: int) -> Array:
        """States `(n, steps, states)` after each of some declared steps from `(n, states)`,
        commands `(n, commands)` held."""
        after = []
        for _ in range(steps):
            states = self.predict_batch(states, issued)
            after.append(states)
        return np.stack(after, axis=1)

    def run(self, initial: Array, issued: Array) -> Array:
        """States `(samples, states)` from one `(states,)` on, under commands `(samples, commands)`
        each held for a declared step."""
        states = [initial]
        for u in issued[:-1]:
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # running away is an answer: it ends as inf or nan
                states.append(self.predict_batch(states[-1][None], u[None])[0])
        return np.stack(states)

    @abstractmethod
    def rollout(self, windows: Windows) -> Array:
        """States `(windows, samples, states)` at the windows' samples, from their initial states on
        issued commands alone."""

    def rollouts(self, windows: Sequence[Windows]) -> list[Array]:
        """The rollouts over several episodes' windows."""
        return [self.rollout(w) for w in windows]

    @abstractmethod
    def description(self) -> dict[str, Json]:
        """The predictor's numbers and names as JSON."""

    @abstractmethod
    def arrays(self) -> dict[str, Array]:
        """The predictor's arrays."""

    @staticmethod
    @abstractmethod
    def restore(
        plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]
    ) -> Predictor:
        """The predictor that was described. Raises KeyError, TypeError or ValueError where
        something is missing or misshapen."""


class Physical(Predictor):
    """A predictor that is the plant's update with some parameters."""

    parameters: tuple[float, ...]

    def predict_batch(
        self, states: Array, issued: Array, h_s: Array | float | None = None
    ) -> Array:
        return self.plant.update(states, issued, self.parameters, h_s)

    def hold(self, states: Array, issued: Array, steps: int) -> Array:
        plant, numbers = self.plant, np.array(self.parameters)
        return plant.dynamics.hold(numbers, states, plant.applied(issued), plant.timestep_s, steps)

    def run(self, initial: Array, issued: Array) -> Array:
        applied = self.plant.applied(issued)[None]
        runs = np.ones(applied.shape[:2], np.int64)
        h_s = np.full(applied.shape[:2], self.plant.timestep_s)
        return np.asarray(
            self.plant.dynamics.rollout(
                np.array([self.parameters]), initial[None], applied, h_s, runs
            )[0, 0]
        )

    def rollout(self, windows: Windows) -> Array:
        applied = self.plant.applied(windows.issued)
        return np.asarray(
            self.plant.dynamics.rollout(
                np.array([self.parameters]), windows.initial, applied, windows.h_s, windows.steps
            )[0]
        )

    def arrays(self) -> dict[str, Array]:
        return {}


@dataclass(frozen=True)
class Nominal(Physical):
    """The plant as declared."""

    plant: Plant
    kind = "nominal"

    @property
    def parameters(self) -> tuple[float, ...]:  # type: ignore[override]
        return self.plant.parameters

    def description(self) -> dict[str, Json]:
        return {}

    @staticmethod
    def restore(
        plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]
    ) -> Nominal:
        return Nominal(plant)


@dataclass(frozen=True)
class Identified(Physical):
    """The plant's form with identified parameters, in the order of its `parameter_names`."""

    plant: Plant
    parameters: tuple[float, ...]
    kind = "identified"

    def description(self) -> dict[str, Json]:
        return {
            "parameters": dict(
                zip(self.plant.dynamics.parameter_names, self.parameters, strict=True)
            )
        }

    @staticmethod
    def restore(
        plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]
    ) -> Identified:
        given = description["parameters"]
        assert isinstance(given, Mapping)
        numbers = (given[name] for name in plant.dynamics.parameter_names)
        return Identified(plant, tuple(float(x) for x in numbers))  # type: ignore[arg-type]


class Stepwise(Predictor):
    """A predictor whose rollout is its own step, again and again."""

    def rollout(self, windows: Windows) -> Array:
        states = np.empty((*windows.issued.shape[:2], windows.initial.shape[1]))
        states[:, 0] = windows.initial
        for i in range(windows.issued.shape[1] - 1):
            now = states[:, i].copy()
            for step in range(int(windows.steps[:, i].max(initial=0))):
                runs = windows.steps[:, i] > step
                with np.errstate(
                    over="ignore", invalid="ignore"
                ):  # running away is an answer: it ends as inf or nan
                    now[runs] = self.predict_batch(
                        now[runs], windows.issued[runs, i], windows.h_s[runs, i]
                    )
            states[:, i + 1] = now
        return states


@dataclass(frozen=True)
class LinearMap:
    """Declared features and the weights of each in each state, `(features, states)`."""

    features: tuple[str, ...]
    weights: Array

    def __call__(
        self, states: Array, issued: Array, parameters: Mapping[str, float] | None = None
    ) -> Array:
        return design(self.features, states, issued, parameters or {}) @ self.weights

    @staticmethod
    def restore(
        plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]
    ) -> LinearMap:
        """The map that was described. Raises BadArtifact where weights and features do not fit."""
        features = tuple(str(f) for f in description["features"])  # type: ignore[union-attr]
        known_features(features, plant.dynamics.parameter_names)
        weights, states = arrays["weights"], 2 * plant.dynamics.joints
        if weights.shape != (len(features), states) or not np.isfinite(weights).all():
            raise BadArtifact(
                f"the weights are {weights.shape}, {len(features)} features and {states} "
                "states need finite ones"
            )
        return LinearMap(features, weights)


@dataclass(frozen=True)
class Blind(Stepwise):
    """One linear map for every plant of a family."""

    plant: Plant
    map: LinearMap
    kind = "blind"

    def predict_batch(
        self, states: Array, issued: Array, h_s: Array | float | None = None
    ) -> Array:
        return _move(states, self.map(states, issued) - states, self.plant, h_s)

    def description(self) -> dict[str, Json]:
        return {"features": list(self.map.features)}

    def arrays(self) -> dict[str, Array]:
        return {"weights": self.map.weights}

    @staticmethod
    def restore(
        plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]
    ) -> Blind:
        return Blind(plant, LinearMap.restore(plant, description, arrays))


@dataclass(frozen=True)
class Conditioned(Stepwise):
    """One linear map for every plant of a family, fed the plant's identified parameters."""

    plant: Plant
    map: LinearMap
    parameters: tuple[float, ...]
    kind = "conditioned"

    def predict_batch(
        self, states: Array, issued: Array, h_s: Array | float | None = None
    ) -> Array:
        fed = dict(zip(self.plant.dynamics.parameter_names, self.parameters, strict=True))
        return _move(states, self.map(states, issued, fed) - states, self.plant, h_s)

    def description(self) -> dict[str, Json]:
        return {
            "features": list(self.map.features),
            **Identified(self.plant, self.parameters).description(),
        }

    def arrays(self) -> dict[str, Array]:
        return {"weights": self.map.weights}

    @staticmethod
    def restore(
        plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]
    ) -> Conditioned:
        parameters = Identified.restore(plant, description, arrays).parameters
        return Conditioned(plant, LinearMap.restore(plant, description, arrays), parameters)


@dataclass(frozen=True)
class Residual(Stepwise):
    """The nominal update plus what it was found to miss in one declared step."""

    plant: Plant
    map: LinearMap
    kind = "residual"

    def predict_batch(
        self, states: Array, issued: Array, h_s: Array | float | None = None
    ) -> Array:
        return _move(
            self.plant.update(states, issued, None, h_s), self.map(states, issued), self.plant, h_s
        )

    def description(self) -> dict[str, Json]:
        return {"features": list(self.map.features)}

    def arrays(self) -> dict[str, Array]:
        return {"weights": self.map.weights}

    @staticmethod
    def restore(
        plant: Plant, description: Mapping[str, Json], arrays: Mapping[str, Array]
    ) -> Residual:
        return Residual(plant, LinearMap.restore(plant, description, arrays))


def _move(states: Array, by: Array, plant: Plant, h_s: Array | float | None) -> Array:
    """A map fitted at the declared step, scaled to another step length."""
    return (
        states + by
        if h_s is None
        else states + by * np.broadcast_to(np.asarray(h_s) / plant.timestep_s, len(states))[:, None]
    )


def predict_observations(predictor: Predictor, windows: Windows) -> Array:
    """Observations `(windows, samples, observations)` of a predictor's rollout."""
    return predictor.plant.observe(predictor.rollout(windows))


def predict_episode(
    predictor: Predictor, episode: Episode, horizon_s: float | None = None
) -> Array:
    """Predicted observations at every sample `(samples, observations)`; rollouts start at each
    multiple of the horizon [s], the declared one if None.
    """
    windows = cut(
        predictor.plant, episode, starts_every(episode.t_s, horizon_s or predictor.plant.horizon_s)
    )
    return np.asarray(predict_observations(predictor, windows)[windows.inside])
