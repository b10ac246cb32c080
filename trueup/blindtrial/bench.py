"""Bench: the user's own plant, commands, rates and noise, as the second simulator takes them.

Where the log was recorded in a closed loop, or the plant has nothing that holds it, a machine that differs would drift away under the
recorded commands alone: there the recorded command is completed by a weak feedback to the recorded motion, so that a machine like
the recorded one gets the recorded command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.admission import Admission, admit
from trueup.diagnose.explore import WINDOW_S
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.rollout_fit import Directions, Fitter
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import refined, series
from trueup.model.state import smoothed_states
from trueup.simulate.machine import KINDS, Feedback
from trueup.simulate.trial import Bench, Plan

Array = NDArray[np.float64]
FINE_S = 5e-4  # the second simulator's step is no longer than this,
LEAST_PARTS = 4  # and no more than a quarter of a sample
STIFFER = 3.0  # times the motion's own rate: the natural frequency of the feedback
DAMPED = 0.7
PLAUSIBLE = 3.0  # times a nominal number, or a third of it: a refit further off has taken up an effect


def bench_of(plant: Plant, episodes: Sequence[Episode]) -> Bench:
    """What the user's episodes were like: their commands and starts, the period and noise of their log, the numbers that fit them.

    Raises NotIdentifiable where there is no adaptation or validation episode, or the plant's family is not one of the simulator's.
    """
    if plant.family not in KINDS:
        raise NotIdentifiable(f"the second simulator knows no family {plant.family!r}", hint=f"It knows {', '.join(sorted(KINDS))}.")
    if not plant.nominal["b"]:
        raise NotIdentifiable("the nominal command gain b is 0: no command moves this plant", hint="Give the plant a nominal b.")
    kept = [e for e in sorted(episodes, key=lambda e: e.digest) if e.role in (Role.ADAPTATION, Role.VALIDATION)]
    for role in (Role.ADAPTATION, Role.VALIDATION):
        if not any(e.role is role for e in kept):
            raise NotIdentifiable(f"there is no {role} episode to take after", hint=f"Give one whose metadata says role = {role}.")
    adaptation = [e for e in kept if e.role is Role.ADAPTATION]
    admission = admit(plant, adaptation)
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
        parts=max(LEAST_PARTS, int(np.ceil(period / FINE_S))),
        duration_s=max(float(e.t_s[-1]) for e in kept),
        noise=float(np.nanmax(admission.noise / admission.motion)),
        feedback=feedback,
        reach=1.0,
        bounds=(float(plant.limits[0][0]), float(plant.limits[1][0])),
        recorded=[_plan(plant, e, period, feedback) for e in kept],
        sigma=(float(np.nan_to_num(admission.noise[0])), float(np.nan_to_num(admission.noise[1]))),
    )


def nominal(plant: Plant, bench: Bench) -> Bench:
    """The same bench with the plant's nominal numbers."""
    return replace(bench, k=plant.nominal.get("k", 0.0), c=plant.nominal["c"], b=plant.nominal["b"])


def _numbers(plant: Plant, admission: Admission, episodes: Sequence[Episode]) -> dict[str, float]:
    """The family's numbers that fit the episodes, or the nominal one where that is not plausible."""
    fitter = Fitter(plant.form, Directions.of_family(plant.dynamics.parameter_names), admission.scales, admission.sigma)
    data = [series(plant, e, refined(plant), min(WINDOW_S, float(e.t_s[-1]))) for e in episodes]
    fitted = fitter.fit(data, Hypothesis(), fitter.begin(plant.parameters), iterations=25).parameters()
    near = {}
    for name, value in plant.nominal.items():
        ratio = fitted[name] / value if value else 0.0
        near[name] = fitted[name] if 1.0 / PLAUSIBLE < ratio < PLAUSIBLE else value
    return near


def _feedback(plant: Plant, admission: Admission, numbers: dict[str, float], episodes: Sequence[Episode]) -> Feedback | None:
    closed = any(e.conditions.get("loop", "").startswith("closed") for e in episodes)
    if "k" in plant.dynamics.parameter_names and not closed:
        return None
    rate = STIFFER * admission.scales[0].velocity / admission.scales[0].position
    return Feedback(rate**2 / numbers["b"], max(0.0, (2.0 * DAMPED * rate - numbers["c"]) / numbers["b"]))


def _plan(plant: Plant, episode: Episode, period: float, feedback: Feedback | None) -> Plan:
    """An episode's command on an even clock, as a reference where there is feedback."""
    states = smoothed_states(plant, episode)
    sound = np.flatnonzero(np.isfinite(states).all(axis=1))
    t = np.arange(round(float(episode.t_s[-1]) / period) + 1) * period
    at = np.minimum(np.searchsorted(episode.t_s, t + 1e-9, side="right") - 1, len(episode.t_s) - 1)
    u = plant.applied(episode.commands)[at, 0]
    if feedback is not None:
        q, v = (np.interp(t, episode.t_s[sound], states[sound, column]) for column in (0, 1))
        u = q + (u + feedback.kd * v) / feedback.kp
    return Plan(str(episode.role), np.ascontiguousarray(u), (float(states[sound[0], 0]), float(states[sound[0], 1])))
