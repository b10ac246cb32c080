"""Bench: the user's own plant, commands, rates and noise, as the second simulator takes them.

Where the log was recorded in a closed loop, or the plant has nothing that holds it, a machine that
differs would drift away under the recorded commands alone: there the recorded command is completed
by a weak feedback to the recorded motion, so that a machine like the recorded one gets the recorded
command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.data_quality import DataQuality, assess
from trueup.diagnose.tuning import SETUP
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.model.dynamics import CompiledTree
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import refined, series
from trueup.model.state import smoothed_states
from trueup.model.tree import GAIN, SERVO, Tree
from trueup.simulate.machine import KINDS, Feedback
from trueup.simulate.robot import Follow, RobotPlan
from trueup.simulate.robot_trial import RobotBench
from trueup.simulate.trial import Bench, Plan

Array = NDArray[np.float64]
FINE_S = 5e-4  # the second simulator's step is no longer than this,
LEAST_PARTS = 4  # and no more than a quarter of a sample
STIFFER = 3.0  # times the motion's own rate: the natural frequency of the feedback
DAMPED = 0.7
PLAUSIBLE = (
    3.0  # times a nominal number, or a third of it: a refit further off has taken up an effect
)


def bench_of(plant: Plant, episodes: Sequence[Episode]) -> Bench | RobotBench:
    """What the user's episodes were like: their commands and starts, the period and noise of their
    log, the numbers that fit them.

    A robot's are its nominal ones: a regression finds sums of masses, and the second simulator
    needs each. Raises NotIdentifiable where there is no adaptation or validation episode, or the
    plant's family is not one of the simulator's.
    """
    if isinstance(plant.dynamics, CompiledTree):
        return _robot_bench(plant, plant.dynamics.tree, _kept(episodes))
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
    kept = _kept(episodes)
    adaptation = [e for e in kept if e.role is Role.ADAPTATION]
    admission = assess(plant, adaptation)
    numbers = _numbers(plant, admission, adaptation)
    period = float(np.median([e.period_s for e in kept]))
    feedback = _feedback(plant, admission, numbers, kept)
    return Bench(
        kind=plant.family,
        k=numbers.get("k", 0.0),
        c=numbers["c"],
        b=numbers["b"],
        limit=float(np.max(np.abs(plant.limits))),
        timestep_s=period,
        parts=_parts(period),
        duration_s=max(float(e.t_s[-1]) for e in kept),
        noise=float(np.nanmax(admission.noise / admission.motion)),
        feedback=feedback,
        reach=1.0,
        bounds=(float(plant.limits[0][0]), float(plant.limits[1][0])),
        recorded=[_plan(plant, e, period, feedback) for e in kept],
        sigma=(float(np.nan_to_num(admission.noise[0])), float(np.nan_to_num(admission.noise[1]))),
    )


def _kept(episodes: Sequence[Episode]) -> list[Episode]:
    kept = [
        e
        for e in sorted(episodes, key=lambda e: e.digest)
        if e.role in (Role.ADAPTATION, Role.VALIDATION)
    ]
    for role in (Role.ADAPTATION, Role.VALIDATION):
        if not any(e.role is role for e in kept):
            raise NotIdentifiable(
                f"there is no {role} episode to take after",
                hint=f"Give one whose metadata says role = {role}.",
            )
    return kept


def _parts(period_s: float) -> int:
    return max(LEAST_PARTS, int(np.ceil(period_s / FINE_S)))


def _robot_bench(plant: Plant, tree: Tree, kept: Sequence[Episode]) -> RobotBench:
    """The same of a robot: it is commanded what was recorded, with a weak feedback to the recorded
    motion at joints that no servo holds."""
    admission = assess(plant, [e for e in kept if e.role is Role.ADAPTATION])
    joints, period, at_joint = (
        len(plant.joints),
        float(np.median([e.period_s for e in kept])),
        tree.at_joint,
    )
    rate = np.array([STIFFER * s.velocity / s.position for s in admission.scales])
    motion = np.concatenate([smoothed_states(plant, e) for e in kept])
    middle = np.nanmedian(motion, axis=0)[:joints]
    inertia = np.diagonal(plant.dynamics.inertia(np.array(plant.parameters), middle[None])[0])
    free = (at_joint[:, SERVO] == 0.0) & (at_joint[:, GAIN] != 0.0)
    gain = np.where(free, at_joint[:, GAIN], 1.0)
    feedback = Follow(
        np.where(free, inertia * rate**2 / gain, 0.0),
        np.where(free, 2.0 * DAMPED * inertia * rate / gain, 0.0),
    )
    bounds = [
        np.where(plant.command_columns >= 0, side[plant.command_columns], 0.0)
        for side in plant.limits
    ]
    return RobotBench(
        tree=tree,
        low=bounds[0],
        high=bounds[1],
        drive=plant.command_scales,
        asked=np.array(
            [s.error if at_joint[j, SERVO] else s.command for j, s in enumerate(admission.scales)]
        ),
        force=np.array([s.acceleration for s in admission.scales]) * plant.form.sizes,
        timestep_s=period,
        parts=_parts(period),
        sigma=np.nan_to_num(admission.noise),
        feedback=feedback if free.any() else None,
        recorded=[_robot_plan(plant, e, period) for e in kept],
    )


def _robot_plan(plant: Plant, episode: Episode, period: float) -> RobotPlan:
    """An episode's commands and motion on an even clock."""
    t, at = _even(episode, period)
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


def _even(episode: Episode, period: float) -> tuple[Array, NDArray[np.int64]]:
    """Times on an even clock, and the sample that holds at each."""
    t = np.arange(round(float(episode.t_s[-1]) / period) + 1) * period
    return np.asarray(t, np.float64), np.minimum(
        np.searchsorted(episode.t_s, t + 1e-9, side="right") - 1, len(episode.t_s) - 1
    )


def nominal(plant: Plant, bench: Bench) -> Bench:
    """The same bench with the plant's nominal numbers."""
    return replace(bench, k=plant.nominal.get("k", 0.0), c=plant.nominal["c"], b=plant.nominal["b"])


def _numbers(plant: Plant, admission: DataQuality, episodes: Sequence[Episode]) -> dict[str, float]:
    """The family's numbers that fit the episodes, or the nominal one where that is not
    plausible."""
    fitter = Fitter(
        plant.form,
        Directions.of_family(plant.dynamics.parameter_names),
        admission.scales,
        admission.sigma,
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
    plant: Plant, admission: DataQuality, numbers: dict[str, float], episodes: Sequence[Episode]
) -> Feedback | None:
    closed = any(e.conditions.get("loop", "").startswith("closed") for e in episodes)
    if "k" in plant.dynamics.parameter_names and not closed:
        return None
    rate = STIFFER * admission.scales[0].velocity / admission.scales[0].position
    return Feedback(
        rate**2 / numbers["b"], max(0.0, (2.0 * DAMPED * rate - numbers["c"]) / numbers["b"])
    )


def _plan(plant: Plant, episode: Episode, period: float, feedback: Feedback | None) -> Plan:
    """An episode's command on an even clock, as a reference where there is feedback."""
    states = smoothed_states(plant, episode)
    sound = np.flatnonzero(np.isfinite(states).all(axis=1))
    t, at = _even(episode, period)
    u = plant.applied(episode.commands)[at, 0]
    if feedback is not None:
        q, v = (np.interp(t, episode.t_s[sound], states[sound, column]) for column in (0, 1))
        u = q + (u + feedback.kd * v) / feedback.kp
    return Plan(
        str(episode.role),
        np.ascontiguousarray(u),
        (float(states[sound[0], 0]), float(states[sound[0], 1])),
    )
