"""Probe: the bounded experiment that would split what the data could not.

Among smooth, stepped and periodic commands inside the declared limits, the one whose predicted observations differ most between
the answer and its nearest rival, in units of the noise, once the rival's own parameters have adapted. A pair that no such
command parts by DETECTABLE is alike under every input: then a sensor or a time stamp must part it.
Source: W. G. Hunter, A. M. Reiner, Technometrics 7 (1965), on designs for discriminating between rival models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.collect.excitation import DETECTABLE
from trueup.diagnose.admission import Admission
from trueup.diagnose.decide import Choice
from trueup.diagnose.problem import Candidate
from trueup.diagnose.search import Search
from trueup.diagnose.twins import TWINS, how_to_part
from trueup.model.block import BLOCK, joint, kind
from trueup.model.block import term as term_at
from trueup.model.hypothesis import switches
from trueup.model.plant import Plant
from trueup.model.series import Series, integral_of, roll, unobserved

Array = NDArray[np.float64]
DURATION_S = 6.0
RATES_HZ = (0.15, 0.4, 1.0, 2.5)
SIZES = (0.25, 0.5, 0.95)  # of the command's limit
PART = 0.3  # of the largest command that was recorded of a robot's joint
SHAPES = ("sine", "square", "ramp and hold", "chirp")


@dataclass(frozen=True, slots=True)
class Experiment:
    """What to do next: which compositions it parts, why it should, and the commands `(samples, joints)` at `t_s`, or None."""

    splits: tuple[tuple[str, ...], ...]
    why: str
    t_s: Array
    command: Array | None
    separation: float

    def document(self, path: str | None, told: Callable[[str], Json] = str) -> dict[str, Json]:
        """The same as JSON, with the command file's path; `told` says how a term is written."""
        return {
            "splits": [[told(t) for t in s] for s in self.splits],
            "why": self.why,
            "separation": self.separation,
            "command": path if self.command is not None else None,
        }

    def csv(self, plant: Plant) -> str:
        """The commands as a table: `t` [s], then each command channel in its declared unit."""
        if self.command is None:
            return ""
        driven = [plant.joint_of(c) for c in plant.layout.commands]
        rows = [[self.t_s[i], *self.command[i, driven]] for i in range(len(self.t_s))]
        head = ",".join(["t", *(c.name for c in plant.layout.commands)])
        return "".join(f"{line}\r\n" for line in [head, *(",".join(repr(float(x)) for x in row) for row in rows)])


def next_experiment(plant: Plant, admission: Admission, search: Search, choice: Choice) -> Experiment | None:
    """The experiment for an answer and its nearest rival; None where there is none."""
    ground = _ground(plant, search)
    if not choice.rivals:
        late = [term for term in choice.winner.hypothesis.effects if kind(term).name == "actuator_delay"]
        if late and len(plant.joints) == 1:
            pair = (late[0],), (term_at("sensor_delay", joint(late[0])),)
            why = "No command parts them: " + TWINS[frozenset({"actuator_delay", "sensor_delay"})] + "."
            return Experiment(pair, why, ground.t_s, None, 0.0)
        return None
    rival = choice.rivals[0]
    splits = choice.winner.hypothesis.effects, rival.hypothesis.effects
    at = joint(min(set(splits[0]) ^ set(splits[1])))
    best, separation = None, 0.0
    for shape, rate, size in product(SHAPES, RATES_HZ, SIZES):
        command = ground.issued.copy()
        command[:, at] += _command(shape, rate, ground.t_s) * size * _reach(plant, admission, at)
        command[:, at] = np.clip(command[:, at], *(bound[plant.command_columns[at]] for bound in plant.limits))
        found = _separation(plant, admission, search, choice.winner, rival, ground, command)
        if found > separation:
            best, separation = command, found
    seconds = float(ground.t_s[-1])
    if best is None or separation < DETECTABLE:
        how = how_to_part(choice.winner.hypothesis, rival.hypothesis) or "another sensor at the joint, or another load, is needed"
        why = f"No command within the limits parts them by {DETECTABLE:g} standard errors: {how}."
        return Experiment(splits, why, ground.t_s, None, separation)
    why = f"The two predictions differ by {separation:.0f} standard errors over {seconds:g} s, after the rival's parameters have adapted."
    return Experiment(splits, why, ground.t_s, best, separation)


def _ground(plant: Plant, search: Search) -> Series:
    """What an experiment adds a wave to: rest of a single joint, the commands of a recorded episode of a robot, which would fall else."""
    if len(plant.joints) == 1:
        t = np.asarray(np.arange(round(DURATION_S / plant.timestep_s) + 1) * plant.timestep_s, np.float64)
        return unobserved(search.problem.scheme, t, np.zeros((len(t), 1)), plant.command_scales, plant.timestep_s)
    recorded = search.problem.adaptation[0]
    kept = slice(0, int(np.searchsorted(recorded.t_s, DURATION_S, "right")))
    steps = recorded.steps[kept].copy()
    steps[-1] = 0
    s = unobserved(recorded.scheme, recorded.t_s[kept], recorded.issued[kept], recorded.u_scale, recorded.period_s)
    return replace(
        s, h_s=recorded.h_s[kept].copy(), steps=steps, begin=recorded.begin[:1], begin_by_positions=recorded.begin_by_positions[:1]
    )


def _reach(plant: Plant, admission: Admission, at: int) -> float:
    """How large a wave may be: within the limits of a single joint, a part of what was recorded of a robot's."""
    return float(np.min(np.abs(plant.limits))) if len(plant.joints) == 1 else PART * admission.scales[at].command


def _command(shape: str, rate: float, t: Array) -> Array:
    wave = np.sin(2.0 * np.pi * rate * t)
    if shape == "square":
        wave = np.where(wave < 0.0, -1.0, 1.0)
    if shape == "chirp":
        wave = np.sin(2.0 * np.pi * rate * t * (0.2 + t / t[-1]))
    return np.asarray(np.clip(3.0 * wave, -1.0, 1.0) if shape == "ramp and hold" else wave)


def _separation(
    plant: Plant, admission: Admission, search: Search, winner: Candidate, rival: Candidate, ground: Series, command: Array
) -> float:
    """Distance of two predictions in standard errors, what the rival's parameters and start could take up removed."""
    s = replace(ground, issued=command, integral=integral_of(command, ground.t_s))
    truth, columns = _predicted(search, winner, s, jacobian=False)[0], _predicted(search, rival, s, jacobian=True)
    if not (np.isfinite(truth).all() and np.isfinite(columns).all()) or not _inside(plant, truth, columns[0]):
        return 0.0
    seen = admission.observed
    differ = ((truth - columns[0])[:, seen] / admission.sigma[seen]).ravel()
    tangent = ((columns[1:] - columns[0])[:, :, seen] / admission.sigma[seen]).reshape(len(columns) - 1, -1).T
    left = differ - tangent @ np.linalg.lstsq(tangent, differ, rcond=1e-10)[0]
    return float(np.sqrt(left @ left))


def _predicted(search: Search, candidate: Candidate, s: Series, *, jacobian: bool) -> Array:
    """Predictions `(1 + free + states, samples, states)`: as fitted, then with each parameter and start moved a little."""
    fitter, fit = search.problem.fitter, candidate.fit
    n, states = (len(fit.free.rows) if jacobian else 0), len(fitter.start_steps)
    lanes = -(-(1 + n + states) // BLOCK) * BLOCK
    p = np.repeat(fit.values[:, None], lanes, axis=1)
    init = np.repeat(s.begin[:, :, None], lanes, axis=2)
    for lane in range(n):
        fit.free.nudge(p[:, lane + 1], lane, fit.free.step[lane])
    for state in range(states if jacobian else 0):
        init[0, state, n + 1 + state] += fitter.start_steps[state]
    out = roll(s, fitter.form, p, switches(fit.hypothesis, fitter.joints), init)
    return np.moveaxis(out, 2, 0)[: n + 1 + states if jacobian else 1]


def _inside(plant: Plant, *paths: Array) -> bool:
    """Whether every path stays inside the declared envelope."""
    for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
        low, high = plant.envelope.get(channel.name, (-np.inf, np.inf))
        if any(path[:, column].min() < low or path[:, column].max() > high for path in paths):
            return False
    return True
