"""The user's plant as blind trials are drawn from it: its commands, rates and noise, as the second
simulator takes them, and the effects that nothing could name on it.

`trial_plant` chooses once which kind of plant it is. Where the log was recorded in a closed loop,
or nothing holds the plant, a machine that differs would drift away under the recorded commands
alone. There a weak feedback to the recorded motion is added to the recorded command, so that a
machine like the recorded one gets the recorded command.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.data_quality import DataQuality, assess
from trueup.diagnose.tuning import SETUP
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.model.block import term
from trueup.model.dynamics import CompiledTree
from trueup.model.effect import Port, effects
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import refined, series
from trueup.model.state import smoothed_states
from trueup.model.tree import (
    ARMATURE,
    FRAME,
    GAIN,
    GRAVITY,
    PARENT,
    SERVO,
    SLIDE,
    STIFFNESS,
    Tree,
)
from trueup.simulate.machine import KINDS, Feedback
from trueup.simulate.robot import Follow, RobotPlan
from trueup.simulate.robot_trial import RobotBench
from trueup.simulate.trial import Bench, JointBench, Plan

Array = NDArray[np.float64]
FINE_S = 5e-4  # the second simulator's step is no longer than this,
LEAST_PARTS = 4  # and no more than a quarter of a sample
STIFFER = 3.0  # times the motion's own rate: the natural frequency of the feedback
DAMPED = 0.7
# A refitted number further from the nominal one than this factor has taken up an effect.
PLAUSIBLE = 3.0


@dataclass(frozen=True)
class TrialPlant(ABC):
    """A user's plant that blind trials are drawn from."""

    plant: Plant

    @abstractmethod
    def absorbed_terms(self) -> tuple[str, ...]:
        """Terms that the nominal form absorbs on this plant's channels: they make no gap, and
        nothing could name them."""

    @abstractmethod
    def bench(self, episodes: Sequence[Episode]) -> Bench:
        """The bench that simulates machines under the commands, starts, period and noise of the
        adaptation and validation episodes.

        Raises NotIdentifiable where one of those roles has no episode, or the second simulator has
        no machine of the plant's family.
        """


@dataclass(frozen=True)
class FamilyPlant(TrialPlant):
    """A plant of one joint, whose nominal model is a family. Machines have the numbers that fit the
    user's episodes."""

    def absorbed_terms(self) -> tuple[str, ...]:
        absorbed = []
        if "k" not in self.plant.dynamics.parameter_names:
            absorbed.append("sensor_bias")  # nothing says where zero is
        if len(self.plant.state_columns) == 1:
            # There is no velocity to lag, and other numbers of the form give the same positions.
            absorbed += ["velocity_lag", "sensor_scale", "clock_skew"]
            if "sensor_bias" in absorbed:
                absorbed.append("sensor_drift")  # a constant force gives the same positions
        return tuple(absorbed)

    def bench(self, episodes: Sequence[Episode]) -> JointBench:
        plant = self.plant
        if plant.family not in KINDS:
            raise NotIdentifiable(
                f"the second simulator knows no family {plant.family!r}",
                hint=f"It knows {', '.join(sorted(KINDS))}, and MJCF.",
            )
        if not plant.nominal["b"]:
            raise NotIdentifiable(
                "the nominal command gain b is 0: no command moves this plant",
                hint="Give the plant a nominal b.",
            )
        recorded = _usable(episodes)
        adaptation = [e for e in recorded if e.role is Role.ADAPTATION]
        quality = assess(plant, adaptation)
        fitted = _fitted_numbers(plant, quality, adaptation)
        period = float(np.median([e.period_s for e in recorded]))
        feedback = _feedback(plant, quality, fitted, recorded)
        return JointBench(
            kind=plant.family,
            k=fitted.get("k", 0.0),
            c=fitted["c"],
            b=fitted["b"],
            limit=float(np.max(np.abs(plant.limits))),
            timestep_s=period,
            parts=_fine_steps(period),
            duration_s=max(float(e.t_s[-1]) for e in recorded),
            noise=float(np.nanmax(quality.noise / quality.motion)),
            feedback=feedback,
            reach=1.0,
            bounds=(float(plant.limits[0][0]), float(plant.limits[1][0])),
            recorded=[_plan(plant, e, period, feedback) for e in recorded],
            sigma=(
                float(np.nan_to_num(quality.noise[0])),
                float(np.nan_to_num(quality.noise[1])),
            ),
            unshifted=(plant.nominal.get("k", 0.0), plant.nominal["c"], plant.nominal["b"]),
        )


@dataclass(frozen=True)
class TreePlant(TrialPlant):
    """A robot given as MJCF. Machines have its nominal numbers: a regression finds sums of masses,
    and the second simulator needs each."""

    tree: Tree

    def absorbed_terms(self) -> tuple[str, ...]:
        return tuple(
            term(name, j) for j in range(len(self.plant.joints)) for name in self._absorbed_at(j)
        )

    def _absorbed_at(self, j: int) -> Iterator[str]:
        """Effects that the nominal form absorbs at joint `j`."""
        constants, own = self.tree.constants[j], self.tree.at_joint[j]
        held = own[SERVO] or own[STIFFNESS]
        down = constants[GRAVITY : GRAVITY + 3]
        moves_alike = constants[PARENT] < 0.0 and (
            constants[SLIDE] or np.allclose(np.cross(constants[FRAME + 6 : FRAME + 9], down), 0.0)
        )
        last = j not in self.tree.constants[:, PARENT]  # its link may be turned as well
        if (moves_alike or last) and not held:
            yield "sensor_bias"  # nothing says where zero is
        if len(self.plant.joints) + j not in self.plant.state_columns:
            yield from ("velocity_lag", "sensor_scale", "clock_skew")
        if own[ARMATURE] <= 0.0:
            yield "elastic_transmission"  # no rotor could be behind a spring
        if self.plant.command_columns[j] < 0:
            yield from (name for name, effect in effects().items() if effect.port is Port.COMMAND)

    def bench(self, episodes: Sequence[Episode]) -> RobotBench:
        """The robot is commanded what was recorded, with a weak feedback to the recorded motion at
        joints that no servo holds."""
        plant, at_joint, recorded = self.plant, self.tree.at_joint, _usable(episodes)
        quality = assess(plant, [e for e in recorded if e.role is Role.ADAPTATION])
        period = float(np.median([e.period_s for e in recorded]))
        free = (at_joint[:, SERVO] == 0.0) & (at_joint[:, GAIN] != 0.0)
        bounds = [
            np.where(plant.command_columns >= 0, side[plant.command_columns], 0.0)
            for side in plant.limits
        ]
        return RobotBench(
            tree=self.tree,
            low=bounds[0],
            high=bounds[1],
            drive=plant.command_scales,
            asked=np.array(
                [s.error if at_joint[j, SERVO] else s.command for j, s in enumerate(quality.scales)]
            ),
            force=np.array([s.acceleration for s in quality.scales]) * plant.form.sizes,
            timestep_s=period,
            parts=_fine_steps(period),
            sigma=np.nan_to_num(quality.noise),
            feedback=self._feedback(quality, recorded, free) if free.any() else None,
            recorded=[_robot_plan(plant, e, period) for e in recorded],
        )

    def _feedback(
        self, quality: DataQuality, recorded: Sequence[Episode], free: NDArray[np.bool_]
    ) -> Follow:
        """The gains of the feedback at the joints that are `free`; 0 elsewhere."""
        plant = self.plant
        rate = np.array([STIFFER * s.velocity / s.position for s in quality.scales])
        motion = np.concatenate([smoothed_states(plant, e) for e in recorded])
        middle = np.nanmedian(motion, axis=0)[: len(plant.joints)]
        inertia = np.diagonal(plant.dynamics.inertia(np.array(plant.parameters), middle[None])[0])
        gain = np.where(free, self.tree.at_joint[:, GAIN], 1.0)
        return Follow(
            np.where(free, inertia * rate**2 / gain, 0.0),
            np.where(free, 2.0 * DAMPED * inertia * rate / gain, 0.0),
        )


def trial_plant(plant: Plant) -> TrialPlant:
    """The plant as blind trials are drawn from it, by the kind of its nominal model."""
    match plant.dynamics:
        case CompiledTree(tree=tree):
            return TreePlant(plant, tree)
        case _:
            return FamilyPlant(plant)


def _usable(episodes: Sequence[Episode]) -> list[Episode]:
    """The adaptation and validation episodes by digest. Raises NotIdentifiable if a role has
    none."""
    usable = [
        e
        for e in sorted(episodes, key=lambda e: e.digest)
        if e.role in (Role.ADAPTATION, Role.VALIDATION)
    ]
    for role in (Role.ADAPTATION, Role.VALIDATION):
        if not any(e.role is role for e in usable):
            raise NotIdentifiable(
                f"there is no {role} episode to take after",
                hint=f"Give one whose metadata says role = {role}.",
            )
    return usable


def _fine_steps(period_s: float) -> int:
    """The second simulator's steps in a sampling period."""
    return max(LEAST_PARTS, int(np.ceil(period_s / FINE_S)))


def _even_clock(episode: Episode, period: float) -> tuple[Array, NDArray[np.int64]]:
    """Times on an even clock [s], and the index of the sample that holds at each."""
    t = np.arange(round(float(episode.t_s[-1]) / period) + 1) * period
    return np.asarray(t, np.float64), np.minimum(
        np.searchsorted(episode.t_s, t + 1e-9, side="right") - 1, len(episode.t_s) - 1
    )


def _robot_plan(plant: Plant, episode: Episode, period: float) -> RobotPlan:
    """An episode's commands and motion on an even clock."""
    t, at = _even_clock(episode, period)
    states = smoothed_states(plant, episode)
    reached = []
    for column in states.T:
        sound = np.isfinite(column)
        reached.append(np.interp(t, episode.t_s[sound], column[sound]))
    return RobotPlan(
        str(episode.role),
        np.ascontiguousarray(plant.applied(episode.commands)[at]),
        np.stack(reached, axis=1),
    )


def _fitted_numbers(
    plant: Plant, quality: DataQuality, episodes: Sequence[Episode]
) -> dict[str, float]:
    """The family's numbers that fit the episodes, each replaced by the nominal one where it is not
    plausible."""
    fitter = Fitter(
        plant.form,
        Directions.of_family(plant.dynamics.parameter_names),
        quality.scales,
        quality.sigma,
    )
    data = [
        series(plant, e, refined(plant), min(SETUP.window_s, float(e.t_s[-1]))) for e in episodes
    ]
    fitted = fitter.fit(
        data, Hypothesis(), fitter.initial_values(plant.parameters), iterations=25
    ).parameters()
    near = {}
    for name, value in plant.nominal.items():
        ratio = fitted[name] / value if value else 0.0
        near[name] = fitted[name] if 1.0 / PLAUSIBLE < ratio < PLAUSIBLE else value
    return near


def _feedback(
    plant: Plant, quality: DataQuality, numbers: dict[str, float], episodes: Sequence[Episode]
) -> Feedback | None:
    """The feedback that holds machines of one joint near the recorded motion; None where a spring
    holds them and no episode was recorded in a closed loop."""
    closed = any(e.conditions.get("loop", "").startswith("closed") for e in episodes)
    if "k" in plant.dynamics.parameter_names and not closed:
        return None
    rate = STIFFER * quality.scales[0].velocity / quality.scales[0].position
    return Feedback(
        rate**2 / numbers["b"], max(0.0, (2.0 * DAMPED * rate - numbers["c"]) / numbers["b"])
    )


def _plan(plant: Plant, episode: Episode, period: float, feedback: Feedback | None) -> Plan:
    """An episode's command on an even clock, as a reference where there is feedback."""
    states = smoothed_states(plant, episode)
    sound = np.flatnonzero(np.isfinite(states).all(axis=1))
    t, at = _even_clock(episode, period)
    u = plant.applied(episode.commands)[at, 0]
    if feedback is not None:
        q, v = (np.interp(t, episode.t_s[sound], states[sound, column]) for column in (0, 1))
        u = q + (u + feedback.kd * v) / feedback.kp
    return Plan(
        str(episode.role),
        np.ascontiguousarray(u),
        (float(states[sound[0], 0]), float(states[sound[0], 1])),
    )
