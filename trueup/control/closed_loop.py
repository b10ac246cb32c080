"""Closed loop: does a better prediction track better? The fixed planner drives a simulated machine with one model and with another.

Both drive the same machine, follow the same references, and draw the same commands: what differs is the model that the planner
rolls out. Stage MIL: it shows what the models do to this planner on this machine as simulated, and nothing of hardware, of time on a
computer, or of what the simulated machine leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.control.estimator import Estimator, transport_delay_s
from trueup.control.loop import Run
from trueup.control.planner import RandomShooting
from trueup.errors import NotIdentifiable
from trueup.model.block import BLOCK
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import switches
from trueup.model.predictor import Predictor
from trueup.model.series import roll, unobserved

Array = NDArray[np.float64]
TICKS = 200
TICKS_A_HORIZON = 40
TURNS = (0.15, 0.3, 0.6)  # of the reference in a horizon: the chapter's is the middle one
SEEDS = 4
SHARE = 0.6  # of the envelope, or of the travel that was recorded
EFFORT = 0.066  # of the squared amplitude, for the whole command: the chapter's 0.02 at its amplitude of 0.55
RESAMPLES = 1000
CANNOT = "hardware, the time that a controller's computer takes, and whatever the simulated machine leaves out"


@dataclass(frozen=True)
class Tracking:
    """Mean squared tracking errors of paired runs `(scenarios x seeds,)` with a candidate and with the incumbent, and breaches' shares."""

    candidate: Array
    incumbent: Array
    breaches: tuple[float, float]
    amplitude: float

    def document(self) -> dict[str, Json]:
        """Both means, the paired difference with a bootstrap interval, relative to the incumbent's, breaches, and what this can show."""
        rng = np.random.default_rng(0)
        drawn = rng.integers(0, len(self.candidate), (RESAMPLES, len(self.candidate)))
        base = max(float(self.incumbent.mean()), 1e-300)
        with np.errstate(invalid="ignore"):  # runs that ran away
            change = (self.candidate - self.incumbent)[drawn].mean(axis=1) / base
            low, high = (float(np.quantile(change, q)) for q in (0.025, 0.975))
        numbers = {
            "candidate": float(self.candidate.mean()),
            "incumbent": float(self.incumbent.mean()),
            "change": float((self.candidate - self.incumbent).mean() / base),
        }
        told: dict[str, Json] = {name: x if isfinite(x) else None for name, x in numbers.items()}
        return {
            "stage": "MIL",
            "runs": len(self.candidate),
            "amplitude": self.amplitude,
            **told,
            "change_ci95": [low, high] if isfinite(low) and isfinite(high) else None,
            "breaches": {"candidate": self.breaches[0], "incumbent": self.breaches[1]},
            "shows": "what either model does to the fixed planner on the machine as it was diagnosed",
            "cannot_show": CANNOT,
        }


def compare(
    machine: Corrected,
    candidate: Predictor,
    incumbent: Predictor,
    travel: float,
    progress: Callable[[float], None] = lambda _: None,
) -> Tracking:
    """Paired runs of both models on a machine that a diagnosis described; `travel` is how far its joint has been recorded.

    Raises NotIdentifiable for a machine of several joints: the fixed planner drives one.
    """
    plant = machine.plant
    if len(plant.joints) != 1 or plant.command_columns[0] < 0:
        raise NotIdentifiable("the fixed planner drives one joint", hint="Leave closed-loop rules out of the gates of robots.")
    position = plant.layout.observations[int(np.flatnonzero(plant.state_columns == 0)[0])].name
    low, high = plant.envelope.get(position, (-travel, travel))
    middle, amplitude = (low + high) / 2.0, SHARE * (high - low) / 2.0
    every = max(1, round(plant.horizon_s / TICKS_A_HORIZON / plant.timestep_s))
    t_s = np.arange(TICKS) * every * plant.timestep_s
    limit = float(np.min(np.abs(plant.limits)))
    errors: dict[str, list[float]] = {"candidate": [], "incumbent": []}
    outside: dict[str, list[float]] = {"candidate": [], "incumbent": []}
    models: Mapping[str, Predictor] = {"candidate": candidate, "incumbent": incumbent}
    total = len(TURNS) * SEEDS * len(models)
    for turns in TURNS:
        reference = middle + amplitude * np.sin(2.0 * np.pi * turns / plant.horizon_s * t_s)
        for seed in range(SEEDS):
            for name, model in models.items():
                planner = RandomShooting(model, limit, effort=EFFORT * amplitude**2 / limit**2, hold=every)
                run = _run(machine, planner, reference, every, np.random.default_rng(seed))
                errors[name].append(run.tracking_error(reference))
                outside[name].append(run.breaches(plant))
                progress(sum(len(e) for e in errors.values()) / total)
    shares = float(np.mean(outside["candidate"])), float(np.mean(outside["incumbent"]))
    return Tracking(np.array(errors["candidate"]), np.array(errors["incumbent"]), shares, amplitude)


def _run(machine: Corrected, planner: RandomShooting, reference: Array, every: int, rng: np.random.Generator) -> Run:
    """One run from rest: the planner sees what the machine's sensors show, and the machine remembers what its effects remember.

    What was seen is brought forward through the commands under way, over the delay that the planner's own model knows of.
    """
    plant = machine.plant
    samples = len(reference) * every + 1
    t_s = np.asarray(np.arange(samples) * plant.timestep_s, np.float64)
    lanes = np.repeat(np.array(machine.values)[:, None], BLOCK, axis=1)
    on, init = switches(machine.hypothesis, 1), np.zeros((1, 2, BLOCK))
    issued, applied = np.zeros((len(reference), 1)), np.zeros((samples, 1))
    states = np.zeros((len(reference) + 1, 2))
    estimator, late_s = Estimator(planner.predictor), transport_delay_s(planner.predictor)
    ahead = round(late_s / (every * plant.timestep_s))  # ticks until a command shows
    for tick in range(len(reference)):
        now, then = tick * every, (tick + 1) * every
        estimator.observed(t_s[now], states[tick])
        aim = float(reference[min(tick + ahead, len(reference) - 1)])
        issued[tick] = planner.plan(estimator.state(t_s[now] + late_s), aim, rng)
        estimator.commanded(t_s[now] + late_s, issued[tick])
        applied[now : then + 1] = plant.applied(issued[tick])
        series = unobserved(machine.scheme, t_s[: then + 1], applied[: then + 1], plant.command_scales, plant.timestep_s)
        with np.errstate(over="ignore", invalid="ignore"):  # a loop that runs away ends as inf, and no rule passes that
            states[tick + 1] = roll(series, plant.form, lanes, on, init)[-1, :, 0]
    return Run(states, issued)
