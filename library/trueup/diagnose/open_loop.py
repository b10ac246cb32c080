"""Open loop: how far models' recursive rollouts go astray, beside the bound on it.

If the true step is L-Lipschitz, and a model's step differs from it by no more than a defect ε
wherever the model goes, then two rollouts from equal starts are after H steps no further apart than

    B_H = ε (1 + L + … + L^(H-1))

Source: by induction, e_(t+1) <= L e_t + ε; E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary
Differential Equations I (1993), section II.3. It bounds a condition, and predicts nothing. The true
step is not known: L is that of what stands in for the machine, at recorded states, and ε is the
largest one-step error that was recorded. So each premise is held against the data, and a measured
error above the bound names the premises that do not hold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.control.machine import STANDS_IN, why_stands_in
from trueup.diagnose.noise import noise_of
from trueup.episode.episode import Episode
from trueup.fit.score import EVERY, Missed, Scoring, missed_in, scored_windows
from trueup.model.block import kind
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.model.state import is_observed, past_states
from trueup.model.windows import Windows

Array = NDArray[np.float64]
HORIZONS = (1, 10, 50, 200)  # steps
LOCAL = 100  # recorded states at which the machine's step is linearised
NUDGE = 1e-4  # of a state's scale, between rounding and what curves
NEGLIGIBLE = 0.01  # of the defect: a start that noise moves by less counts as equal
HAIR = 0.01  # of the recorded range, by which a state may lie beyond it
EXACT = 1e-9  # of the scales: what rounding leaves of an equal start
EVEN = 1e-3  # of the declared step, by which stamps may be off it
ROUNDING = 1e-9  # of an error, by which a proven bound may seem broken


@dataclass(frozen=True, slots=True)
class Rollouts:
    """One model's rollouts on one episode: dimensionless errors `(windows, samples)`, which of them
    count, the declared steps from the window's start to each sample, the states rolled out
    `(windows, samples, states)` and the commands issued at them."""

    errors: Array
    inside: NDArray[np.bool_]
    steps: NDArray[np.int64]
    states: Array
    issued: Array


@dataclass(frozen=True, slots=True)
class Recorded:
    """The box of recorded states, `low` and `high` `(states,)`."""

    low: Array
    high: Array

    @staticmethod
    def of(plant: Plant, episodes: Sequence[Episode]) -> Recorded:
        """The box of some episodes."""
        states = np.concatenate([past_states(plant, e) for e in episodes])
        return Recorded(np.nanmin(states, axis=0), np.nanmax(states, axis=0))

    def outside(self, states: Array) -> NDArray[np.bool_]:
        """Which states `(n, states)` lie outside of it, by more than a hair."""
        slack = HAIR * (self.high - self.low)
        inside = (states >= self.low - slack) & (states <= self.high + slack)
        return np.asarray(~inside.all(axis=1))


def open_loop(
    models: Mapping[str, Predictor],
    machine: tuple[str, Predictor],
    episodes: Sequence[Episode],
    horizons: Sequence[int] = HORIZONS,
    progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Json]:
    """Errors of rollouts after some numbers of declared steps, and the bound, as the document
    `trueup.openloop/1`. `machine` is what stands in for the true step, with its name.

    Raises NotAnEpisode where an episode has nothing to score, ValueError without models or
    episodes.
    """
    if not models or not episodes:
        raise ValueError("an open loop needs a model and an episode")
    plant = machine[1].plant
    horizons, scales = sorted(set(horizons)), plant.state_scales
    lipschitz = _lipschitz(machine[1], episodes, scales)
    progress(0.1)
    common = [
        _observed(plant, episodes),
        _one_length(plant, episodes),
        _memory(machine[1]),
    ]
    one_step = {
        name: np.concatenate(list(_one_step_errors(model, episodes)))
        for name, model in models.items()
    }
    progress(0.4)
    # noise is part of every model's error of one step
    noise = min(_noise_norm(plant, episodes), *(float(np.median(x)) for x in one_step.values()))
    recorded = Recorded.of(plant, episodes)
    rows: list[Json] = []
    for done, (name, model) in enumerate(models.items(), 1):
        rollouts = [_rollouts(model, e, horizons[-1]) for e in episodes]
        defect = float(one_step[name].max())
        rows.append(
            {
                "model": name,
                "defect": _number(defect),
                "defect_median": _number(float(np.median(one_step[name]))),
                "errors": [_at(rollouts, h, rollout_bound(defect, lipschitz, h)) for h in horizons],
                "premises": [
                    _equal_starts(noise, defect),
                    _defect_covers(recorded, model, machine[1], rollouts, defect, scales),
                    _grows_as_bounded(rollouts, lipschitz, defect),
                ],
            }
        )
        progress(0.4 + 0.6 * done / len(models))
    return {
        "schema": "trueup.openloop/1",
        "plant": plant.name,
        "machine": {
            "model": machine[0],
            "kind": machine[1].kind,
            "stands_in": STANDS_IN[machine[1].kind],
            "why": why_stands_in(machine[1].kind),
        },
        "step_s": plant.timestep_s,
        "horizons_steps": list(horizons),
        "scales": {c.name: c.scale for c in plant.layout.observations},
        "state_scales": scales.tolist(),
        "lipschitz": lipschitz,
        "noise": noise,
        "episodes": [{"sha256": e.digest, "role": str(e.role)} for e in episodes],
        "premises": common,
        "models": rows,
    }


def rollout_bound(defect: float, lipschitz: float, steps: int) -> float:
    """B_H = defect x sum of lipschitz^j for j < H; infinite where it overflows.

    It bounds a rollout from an equal start, and predicts nothing.
    """
    with np.errstate(over="ignore"):
        return defect * float(np.sum(np.float64(lipschitz) ** np.arange(steps)))


def _rollouts(model: Predictor, episode: Episode, steps: int) -> Rollouts:
    plant = model.plant
    windows = scored_windows(plant, episode, Scoring(steps * plant.timestep_s, EVERY))
    with np.errstate(over="ignore", invalid="ignore"):
        states = model.rollout(windows)
    missed = missed_in(model, windows)
    return Rollouts(
        missed.norms(plant.scales),
        missed.inside,
        _steps(plant, windows),
        states,
        windows.issued,
    )


def _one_step_errors(model: Predictor, episodes: Sequence[Episode]) -> Iterator[Array]:
    """The error of one declared step from each sample, of each episode."""
    plant = model.plant
    for episode in episodes:
        windows = scored_windows(plant, episode, Scoring(plant.timestep_s, EVERY))
        missed: Missed = missed_in(model, windows)
        yield missed.norms(plant.scales)[:, 1:][missed.inside[:, 1:]]


def _steps(plant: Plant, windows: Windows) -> NDArray[np.int64]:
    """Declared steps from a window's start to each of its samples, `(windows, samples)`."""
    t_s = windows.episode.t_s[windows.rows]
    return np.rint((t_s - t_s[:, :1]) / plant.timestep_s).astype(np.int64)


def _at(rollouts: Sequence[Rollouts], steps: int, bound: float) -> dict[str, Json]:
    """Errors of every window after a number of steps, beside the bound."""
    errors = np.concatenate([r.errors[r.inside & (r.steps == steps)] for r in rollouts])
    worst = float(errors.max()) if len(errors) else float("nan")
    return {
        "steps": steps,
        "windows": len(errors),
        "mean": _number(float(errors.mean())) if len(errors) else None,
        "max": _number(worst),
        "bound": _number(bound),
        "exceeds": bool(worst > bound * (1.0 + ROUNDING)) if len(errors) else None,
    }


def _lipschitz(machine: Predictor, episodes: Sequence[Episode], scales: Array) -> float:
    """The largest gain of one declared step between states, in their scales, over recorded states:
    the largest singular value of the step's derivative."""
    states, issued = _recorded(machine.plant, episodes)
    n = len(scales)
    nudges = NUDGE * np.diag(scales)
    around = (states[:, None, :] + np.concatenate([nudges, -nudges])[None]).reshape(-1, n)
    with np.errstate(over="ignore", invalid="ignore"):
        moved = machine.predict_batch(around, np.repeat(issued, 2 * n, axis=0))
    ahead, behind = np.split(moved.reshape(len(states), 2 * n, n), 2, axis=1)
    # row i is the derivative along state i
    slopes = (ahead - behind) / (2.0 * NUDGE) / scales
    return float(np.linalg.svd(slopes, compute_uv=False).max())


def _recorded(plant: Plant, episodes: Sequence[Episode]) -> tuple[Array, Array]:
    """LOCAL recorded states `(n, states)`, spread over all samples, and their commands."""
    states = np.nan_to_num(np.concatenate([past_states(plant, e) for e in episodes]))
    issued = np.concatenate([e.commands for e in episodes])
    rows = np.unique(np.linspace(0, len(states) - 1, LOCAL).astype(np.int64))
    return states[rows], issued[rows]


def _noise_norm(plant: Plant, episodes: Sequence[Episode]) -> float:
    """The norm of the observations' noise, each channel in its scale."""
    total = 0.0
    for at, channel in enumerate(plant.layout.observations):
        tracks = [(e.observations[:, at], np.zeros(len(e.t_s), np.bool_)) for e in episodes]
        if any(np.isfinite(x).sum() > len(HORIZONS) for x, _ in tracks):
            total += (noise_of(tracks).sigma / channel.scale) ** 2
    return float(np.sqrt(total))


def _premise(name: str, holds: bool | None, because: str, **figures: Json) -> dict[str, Json]:
    return {"premise": name, "holds": holds, "because": because, **figures}


def _equal_starts(noise: float, defect: float) -> Json:
    holds = noise <= max(NEGLIGIBLE * defect, EXACT)
    because = (
        f"a rollout starts at what was observed, whose noise of {noise:.3g} is "
        f"{'small against' if holds else 'not small against'} the defect of {defect:.3g}"
    )
    return _premise("equal_starts", holds, because, noise=noise)


def _defect_covers(
    recorded: Recorded,
    model: Predictor,
    machine: Predictor,
    rollouts: Sequence[Rollouts],
    defect: float,
    scales: Array,
) -> Json:
    """Whether the defect holds wherever the rollouts go: inside the box of recorded states, or by
    the step of what stands in for the machine."""
    name = "defect_holds_where_it_goes"
    visited = np.concatenate([r.states[r.inside] for r in rollouts])
    issued = np.concatenate([r.issued[r.inside] for r in rollouts])
    outside = recorded.outside(visited)
    share = float(outside.mean())
    if share == 0.0:
        because = "every rolled-out state lies among the recorded ones, where it was measured"
        return _premise(name, True, because, outside=share)
    left = f"{100 * share:.3g} % of the rolled-out states lie outside the recorded ones"
    if model is machine:
        because = f"{left}, and this model itself stands in for the machine"
        return _premise(name, False, because, outside=share)
    there = _difference(model, machine, visited[outside], issued[outside], scales)
    holds = there <= defect
    because = (
        f"{left}; there the model's step differs from that of what stands in for the machine by "
        f"up to {there:.3g}, {'within' if holds else 'beyond'} the defect of {defect:.3g}"
    )
    return _premise(name, holds, because, outside=share, defect_there=_number(there))


def _difference(
    model: Predictor, machine: Predictor, states: Array, issued: Array, scales: Array
) -> float:
    """The largest difference of two models' steps at LOCAL of some states, in their scales."""
    rows = np.unique(np.linspace(0, len(states) - 1, LOCAL).astype(np.int64))
    with np.errstate(over="ignore", invalid="ignore"):
        steps = (m.predict_batch(states[rows], issued[rows]) for m in (model, machine))
        apart = np.linalg.norm((next(steps) - next(steps)) / scales, axis=1)
    return float(apart.max()) if np.isfinite(apart).all() else float("inf")


def _grows_as_bounded(rollouts: Sequence[Rollouts], lipschitz: float, defect: float) -> Json:
    """Whether each error follows from the one a step before: e' <= L e + ε."""
    broken = total = 0
    for r in rollouts:
        one = r.inside[:, 1:] & (np.diff(r.steps, axis=1) == 1)
        before, after = r.errors[:, :-1][one], r.errors[:, 1:][one]
        with np.errstate(over="ignore", invalid="ignore"):
            allowed = (lipschitz * before + defect) * (1.0 + ROUNDING)
        broken += int((~(after <= allowed)).sum())
        total += int(one.sum())
    share = broken / total if total else 0.0
    because = (
        f"no error grew in a step by more than L = {lipschitz:.6g} and the defect allow"
        if broken == 0
        else f"in {100 * share:.3g} % of the steps the error grew by more than L = "
        f"{lipschitz:.6g} and the defect allow: the true step is steeper somewhere, or the "
        "defect larger"
    )
    return _premise("lipschitz", broken == 0, because, share=share)


def _observed(plant: Plant, episodes: Sequence[Episode]) -> Json:
    holds = all(is_observed(plant, e) for e in episodes)
    because = (
        "every position and velocity is observed"
        if holds
        else "a velocity that nobody observes is estimated from positions, at starts too"
    )
    return _premise("state_observed", holds, because)


def _one_length(plant: Plant, episodes: Sequence[Episode]) -> Json:
    off = max(float(np.abs(np.diff(e.t_s) / plant.timestep_s - 1.0).max()) for e in episodes)
    holds = off <= EVEN
    because = (
        "samples are one declared step apart"
        if holds
        else f"intervals between samples are off the declared step by up to {100 * off:.3g} % of it"
    )
    return _premise("one_step_length", holds, because, worst=off)


def _memory(machine: Predictor) -> Json:
    if not isinstance(machine, Corrected):
        because = "nobody has diagnosed the machine, so whether it remembers is not known"
        return _premise("no_memory", None, because)
    terms = [t for t in machine.hypothesis.effects if kind(t).states or kind(t).delays()]
    names = ", ".join(machine.plant.term_words(t).replace("_", " ") for t in terms)
    because = (
        f"the next state depends on more than the last one: {names}"
        if terms
        else "no effect of the diagnosis remembers anything"
    )
    return _premise("no_memory", not terms, because)


def _number(value: float) -> float | None:
    return value if isfinite(value) else None
