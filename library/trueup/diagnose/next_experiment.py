"""Next experiment: the bounded experiment that would split what the data could not.

Among smooth, stepped and periodic commands inside the declared limits, under which both models stay
inside the envelope, the one whose predicted observations differ most between the answer and its
nearest rival, in units of the noise, once the rival's own parameters have adapted. Where no
envelope is declared it is the recorded range. A pair that no such command parts by DETECTABLE is
alike under every input: then a sensor or a time stamp must part it. Source: W. G. Hunter, A. M.
Reiner, Technometrics 7 (1965), on designs for discriminating between rival models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.collect.bounds import DECLARED, Bounds, Recorded
from trueup.collect.checklist import begins_at, command_table
from trueup.collect.excitation import DETECTABLE
from trueup.collect.wave import followed
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.indistinguishable import ALIASES, how_to_part
from trueup.diagnose.model_selection import Choice
from trueup.diagnose.search import Search
from trueup.diagnose.tuning_of_answers import EXPERIMENT
from trueup.model.block import BLOCK, joint, kind
from trueup.model.block import term as term_at
from trueup.model.hypothesis import switches
from trueup.model.plant import Plant
from trueup.model.roll import roll
from trueup.model.series import Series, integral_of, unobserved

Array = NDArray[np.float64]
SHAPES = ("sine", "square", "ramp and hold", "chirp")


@dataclass(frozen=True, slots=True)
class Experiment:
    """What to do next: which compositions it parts, why it should, and the commands `(samples,
    joints)` at `t_s`, or None."""

    splits: tuple[tuple[str, ...], ...]
    why: str
    t_s: Array
    command: Array | None
    separation: float
    check_first: tuple[str, ...] = ()

    def document(self, path: str | None, written: Callable[[str], Json] = str) -> dict[str, Json]:
        """The experiment as JSON, with the command file's path; `written` says how a term is
        written."""
        return {
            "splits": [[written(t) for t in s] for s in self.splits],
            "why": self.why,
            "separation": self.separation,
            "command": path if self.command is not None else None,
        }

    def csv(self, plant: Plant) -> str:
        """The commands as a table, with what to check before it; empty where there are none."""
        return (
            ""
            if self.command is None
            else command_table(plant, self.t_s, self.command, self.check_first)
        )


def next_experiment(
    plant: Plant, quality: DataQuality, search: Search, choice: Choice, recorded: Recorded
) -> Experiment | None:
    """The experiment for an answer and its nearest rival, within what is declared or was
    `recorded`; None where there is none."""
    if not choice.rivals:
        late = [
            term for term in choice.winner.hypothesis.effects if kind(term).name == "actuator_delay"
        ]
        if late and not search.problem.strategy.robot:
            pair = (late[0],), (term_at("sensor_delay", joint(late[0])),)
            why = (
                "No command parts them: "
                + ALIASES[frozenset({"actuator_delay", "sensor_delay"})]
                + "."
            )
            return Experiment(pair, why, np.zeros(0), None, 0.0)
        return None
    bounds = _bounds(plant, recorded)
    ground = _ground(plant, search, choice.winner, bounds)
    rival = choice.rivals[0]
    splits = choice.winner.hypothesis.effects, rival.hypothesis.effects
    at = joint(min(set(splits[0]) ^ set(splits[1])))
    best, separation, beyond = None, 0.0, 0.0
    for shape, rate, size in product(SHAPES, EXPERIMENT.rates_hz, EXPERIMENT.sizes):
        command = ground.issued.copy()
        command[:, at] += (
            _command(shape, rate, ground.t_s) * size * _reach(search, plant, quality, at)
        )
        command = np.clip(command, bounds.low, bounds.high)
        command = np.asarray(
            followed(np.ascontiguousarray(command), ground.issued[0], bounds.rate * ground.period_s)
        )
        parted, inside = _separation(
            quality, search, choice.winner, rival, replace(ground, issued=command), bounds
        )
        beyond = beyond if inside else max(beyond, parted)
        if inside and parted > separation:
            best, separation = command, parted
    seconds = float(ground.t_s[-1])
    kept = "declared envelope" if _declared(plant, bounds) else "recorded range"
    if best is None or separation < DETECTABLE:
        if beyond >= DETECTABLE:
            why = (
                f"No command that keeps the machine inside its {kept} parts them by "
                f"{DETECTABLE:g} standard errors. One that leaves it "
                "would: declare a wider envelope in plant.json, if there is room."
            )
            return Experiment(splits, why, ground.t_s, None, separation)
        how = (
            how_to_part(choice.winner.hypothesis, rival.hypothesis)
            or "another sensor at the joint, or another load, is needed"
        )
        why = f"No command within the limits parts them by {DETECTABLE:g} standard errors: {how}."
        return Experiment(splits, why, ground.t_s, None, separation)
    why = (
        f"The two predictions differ by {separation:.0f} standard errors over {seconds:g} s, "
        "after the rival's parameters have adapted."
    )
    return Experiment(splits, why, ground.t_s, best, separation, _checks(plant, ground, kept))


def _bounds(plant: Plant, recorded: Recorded) -> Bounds:
    """The declared envelope, or where it leaves the travel of a joint open what was recorded of
    travel, speed and rate."""
    observed = {
        c.name
        for c, column in zip(plant.layout.observations, plant.state_columns, strict=True)
        if column < len(plant.joints)
    }
    if observed <= set(plant.envelope):
        return Bounds.of(plant, EXPERIMENT.duration_s, rate=np.inf, margin=0.0)
    return Bounds.of(plant, EXPERIMENT.duration_s, margin=0.0, recorded=recorded)


def _declared(plant: Plant, bounds: Bounds) -> bool:
    return set(bounds.sources[: len(plant.joints)]) == {DECLARED}


def _checks(plant: Plant, ground: Series, kept: str) -> tuple[str, ...]:
    """What to check before the command is played."""
    return (
        f"Before you play this: it begins at {begins_at(plant, ground.begin[0])}, and keeps "
        f"the {kept} under the answer and its nearest alternative. No other model was "
        "checked.",
        (
            "It does not end at rest: be ready to stop the machine. `trueup excite` designs "
            "one that does, safe under every model in play."
        ),
    )


def _ground(plant: Plant, search: Search, winner: Candidate, bounds: Bounds) -> Series:
    """What an experiment adds a wave to: rest of a single joint, in the middle of its travel where
    it rests anywhere; of a robot, which would fall else, the commands of a recorded episode, drawn
    in about their mean to leave room for the wave where no envelope is declared.
    """
    if not search.problem.strategy.robot:
        t = np.asarray(
            np.arange(round(EXPERIMENT.duration_s / plant.timestep_s) + 1) * plant.timestep_s,
            np.float64,
        )
        rest = unobserved(
            search.problem.scheme, t, np.zeros((len(t), 1)), plant.command_scales, plant.timestep_s
        )
        low, high = bounds.envelope[0]
        middle = replace(rest, begin=np.array([[(low + high) / 2.0, 0.0]]))
        moved = np.ptp(_predicted(search, winner, middle, jacobian=False)[0, :, 0])
        return middle if moved < EXPERIMENT.free * (high - low) else rest
    recorded = search.problem.adaptation[0]
    kept = slice(0, int(np.searchsorted(recorded.t_s, EXPERIMENT.duration_s, "right")))
    steps = recorded.steps[kept].copy()
    steps[-1] = 0
    mean, drawn_in = (
        recorded.issued.mean(axis=0),
        1.0 if _declared(plant, bounds) else 1.0 - EXPERIMENT.part_of_recorded,
    )
    issued = mean + drawn_in * (recorded.issued[kept] - mean)
    s = unobserved(recorded.scheme, recorded.t_s[kept], issued, recorded.u_scale, recorded.period_s)
    return replace(
        s,
        h_s=recorded.h_s[kept].copy(),
        steps=steps,
        begin=recorded.begin[:1],
        begin_by_positions=recorded.begin_by_positions[:1],
    )


def _reach(search: Search, plant: Plant, quality: DataQuality, at: int) -> float:
    """How large a wave may be: within the limits of a single joint, a part of what was recorded of
    a robot's."""
    return (
        float(np.min(np.abs(plant.limits)))
        if not search.problem.strategy.robot
        else EXPERIMENT.part_of_recorded * quality.scales[at].command
    )


def _command(shape: str, rate: float, t: Array) -> Array:
    wave = np.sin(2.0 * np.pi * rate * t)
    if shape == "square":
        wave = np.where(wave < 0.0, -1.0, 1.0)
    if shape == "chirp":
        wave = np.sin(2.0 * np.pi * rate * t * (0.2 + t / t[-1]))
    return np.asarray(np.clip(3.0 * wave, -1.0, 1.0) if shape == "ramp and hold" else wave)


def _separation(
    quality: DataQuality,
    search: Search,
    winner: Candidate,
    rival: Candidate,
    commanded: Series,
    bounds: Bounds,
) -> tuple[float, bool]:
    """Distance of two predictions in standard errors, what the rival's parameters and start could
    take up removed; and whether both stay within the bounds.
    """
    s = replace(commanded, integral=integral_of(commanded.issued, commanded.t_s))
    truth, columns = (
        _predicted(search, winner, s, jacobian=False)[0],
        _predicted(search, rival, s, jacobian=True),
    )
    if not (np.isfinite(truth).all() and np.isfinite(columns).all()):
        return 0.0, False
    seen = quality.observed
    differ = ((truth - columns[0])[:, seen] / quality.sigma[seen]).ravel()
    tangent = (
        ((columns[1:] - columns[0])[:, :, seen] / quality.sigma[seen])
        .reshape(len(columns) - 1, -1)
        .T
    )
    left = differ - tangent @ np.linalg.lstsq(tangent, differ, rcond=1e-10)[0]
    return float(np.sqrt(left @ left)), bounds.inside(np.stack([truth, columns[0]]))


def _predicted(search: Search, candidate: Candidate, s: Series, *, jacobian: bool) -> Array:
    """Predictions `(1 + free + states, samples, states)`: as fitted, then with each parameter and
    start moved a little."""
    fitter, fit = search.problem.fitter, candidate.fit
    n, states = (len(fit.free.rows) if jacobian else 0), len(fitter.start_steps)
    lanes = -(-(1 + n + states) // BLOCK) * BLOCK
    p = np.repeat(fit.values[:, None], lanes, axis=1)
    init = np.repeat(s.begin[:, :, None], lanes, axis=2)
    numbers = np.arange(n)
    fit.free.nudge(p, 1 + numbers, numbers, fit.free.step[:n])
    for state in range(states if jacobian else 0):
        init[0, state, n + 1 + state] += fitter.start_steps[state]
    out = roll(s, fitter.form, p, switches(fit.hypothesis, fitter.joints), init)
    return np.moveaxis(out, 2, 0)[: n + 1 + states if jacobian else 1]
