"""Probe: the bounded experiment that would split what the data could not.

Among smooth, stepped and periodic commands inside the declared limits, the one whose predicted observations differ most between
the answer and its nearest rival, in units of the noise, once the rival's own parameters have adapted. A pair that no such
command parts by DETECTABLE is alike under every input: then a sensor or a time stamp must part it.
Source: W. G. Hunter, A. M. Reiner, Technometrics 7 (1965), on designs for discriminating between rival models.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.diagnose.admission import Admission
from trueup.diagnose.decide import Choice
from trueup.diagnose.search import Candidate, Search
from trueup.diagnose.twins import TWINS
from trueup.model.block import BLOCK
from trueup.model.hypothesis import switches
from trueup.model.plant import Plant
from trueup.model.series import Series, roll, unobserved

Array = NDArray[np.float64]
DURATION_S = 6.0
DETECTABLE = 4.0  # standard errors between two predictions, over the whole experiment
RATES_HZ = (0.15, 0.4, 1.0, 2.5)
SIZES = (0.25, 0.5, 0.95)  # of the command's limit
SHAPES = ("sine", "square", "ramp and hold", "chirp")


@dataclass(frozen=True, slots=True)
class Experiment:
    """What to do next: which compositions it parts, why it should, and the command `(samples,)` at `t_s`, or None."""

    splits: tuple[tuple[str, ...], ...]
    why: str
    t_s: Array
    command: Array | None
    separation: float

    def document(self, path: str | None) -> dict[str, Json]:
        """The same as JSON, with the command file's path."""
        return {
            "splits": [list(s) for s in self.splits],
            "why": self.why,
            "separation": self.separation,
            "command": path if self.command is not None else None,
        }


def next_experiment(plant: Plant, admission: Admission, search: Search, choice: Choice) -> Experiment | None:
    """The experiment for an answer and its nearest rival; None where there is none."""
    t = np.asarray(np.arange(round(DURATION_S / plant.timestep_s) + 1) * plant.timestep_s, np.float64)
    if not choice.rivals:
        if "actuator_delay" in choice.winner.hypothesis.effects:
            pair = ("actuator_delay",), ("sensor_delay",)
            return Experiment(pair, "No command parts them: " + TWINS[frozenset(pair[0] + pair[1])] + ".", t, None, 0.0)
        return None
    rival = choice.rivals[0]
    splits = choice.winner.hypothesis.effects, rival.hypothesis.effects
    best, separation = None, 0.0
    for shape, rate, size in product(SHAPES, RATES_HZ, SIZES):
        command = _command(shape, rate, t) * size * float(np.min(np.abs(plant.limits)))
        found = _separation(plant, admission, search, choice.winner, rival, t, command)
        if found > separation:
            best, separation = command, found
    if best is None or separation < DETECTABLE:
        differing = frozenset(splits[0]) ^ frozenset(splits[1])
        how = TWINS.get(differing, "another sensor at the joint, or another load, is needed")
        return Experiment(splits, f"No command within the limits parts them by {DETECTABLE:g} standard errors: {how}.", t, None, separation)
    why = (
        f"The two predictions differ by {separation:.0f} standard errors over {DURATION_S:g} s, after the rival's parameters have adapted."
    )
    return Experiment(splits, why, t, best, separation)


def _command(shape: str, rate: float, t: Array) -> Array:
    wave = np.sin(2.0 * np.pi * rate * t)
    if shape == "square":
        wave = np.where(wave < 0.0, -1.0, 1.0)
    if shape == "chirp":
        wave = np.sin(2.0 * np.pi * rate * t * (0.2 + t / t[-1]))
    return np.asarray(np.clip(3.0 * wave, -1.0, 1.0) if shape == "ramp and hold" else wave)


def _separation(plant: Plant, admission: Admission, search: Search, winner: Candidate, rival: Candidate, t: Array, command: Array) -> float:
    """Distance of two predictions in standard errors, what the rival's parameters and start could take up removed."""
    s = unobserved(search.adaptation[0].scheme, t, command, float(np.max(np.abs(plant.limits))), plant.timestep_s)
    truth, columns = _predicted(search, winner, s, jacobian=False)[0], _predicted(search, rival, s, jacobian=True)
    if not (np.isfinite(truth).all() and np.isfinite(columns).all()) or not _inside(plant, truth, columns[0]):
        return 0.0
    seen = admission.observed
    differ = ((truth - columns[0])[:, seen] / admission.sigma[seen]).ravel()
    tangent = ((columns[1:] - columns[0])[:, :, seen] / admission.sigma[seen]).reshape(len(columns) - 1, -1).T
    left = differ - tangent @ np.linalg.lstsq(tangent, differ, rcond=1e-10)[0]
    return float(np.sqrt(left @ left))


def _predicted(search: Search, candidate: Candidate, s: Series, *, jacobian: bool) -> Array:
    """Predictions from rest `(1 + free + 2, samples, 2)`: as fitted, then with each parameter and start moved a little."""
    fitter, fit = search.fitter, candidate.fit
    p = np.repeat(fit.values[:, None], BLOCK, axis=1)
    init = np.zeros((1, 2, BLOCK))
    n = len(fit.free.rows) if jacobian else 0
    for lane, row in enumerate(fit.free.rows[:n], start=1):
        p[row, lane] += fit.free.step[lane - 1]
    if jacobian:
        init[0, 0, n + 1], init[0, 1, n + 2] = fitter.start_steps
    out = roll(s, fitter.family, p, switches(fit.hypothesis), init)
    return np.moveaxis(out, 2, 0)[: n + 3 if jacobian else 1]


def _inside(plant: Plant, *paths: Array) -> bool:
    """Whether every path stays inside the declared envelope."""
    for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
        low, high = plant.envelope.get(channel.name, (-np.inf, np.inf))
        if any(path[:, column].min() < low or path[:, column].max() > high for path in paths):
            return False
    return True
