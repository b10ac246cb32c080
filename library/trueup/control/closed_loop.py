"""Closed loop: does a better prediction track better?

A fixed planner drives a simulated machine with one model and with another. Both runs have the same
machine, references and random draws; they differ in the model that the planner rolls out. Stage
MIL: the figures show what the models do to this planner on this simulated machine. They show
nothing of hardware, of computing time, or of what the simulated machine leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.control.estimator import Estimator, transport_delay_s
from trueup.control.loop import LoopRun
from trueup.control.planner import Linearised, Planner, RandomShooting
from trueup.episode.episode import Episode
from trueup.errors import NotIdentifiable
from trueup.model.block import BLOCK
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import switches
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.model.series import roll, unobserved
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
TICKS = 200
TICKS_A_HORIZON = 40
TURNS = (0.15, 0.3, 0.6)  # of the reference in a horizon: the chapter's is the middle one
SEEDS = 4
SHARE = 0.6  # of the envelope, or of the travel that was recorded
# of the squared amplitude, for the whole command: the chapter's 0.02 at its amplitude of 0.55
EFFORT = 0.066
FAST = 0.99  # of the recorded speeds are no higher than the highest: one glitch is none
MOVED = 20.0  # times what noise moves a joint
BEGINS = 0.2  # of the amplitude: where a robot's joints begin
RESAMPLES = 1000
CANNOT = (
    "hardware, the time that a controller's computer takes, and whatever the simulated "
    "machine leaves out"
)


@dataclass(frozen=True)
class Travelled:
    """How far each joint has been recorded, `low` and `high` `(joints,)`, how fast, `speed`
    `(joints,)`, and which of them `moved`."""

    low: Array
    high: Array
    speed: Array
    moved: NDArray[np.bool_]

    @staticmethod
    def of(plant: Plant, episodes: Sequence[Episode]) -> Travelled:
        """The travel in recordings. A single joint may go as far to either side."""
        joints = len(plant.joints)
        states = np.concatenate([smoothed_states(plant, e) for e in episodes])
        positions, speed = (
            states[:, :joints],
            np.nanquantile(np.abs(states[:, joints:]), FAST, axis=0),
        )
        if joints == 1:
            far = np.nanmax(np.abs(positions), axis=0)
            return Travelled(-far, far, speed, np.ones(1, np.bool_))
        low, high = np.nanmin(positions, axis=0), np.nanmax(positions, axis=0)
        # what noise alone moves from sample to sample
        shakes = np.nanstd(np.diff(positions, n=2, axis=0), axis=0)
        return Travelled(low, high, speed, (high > low) & (high - low > MOVED * shakes))


@dataclass(frozen=True)
class Tracking:
    """Tracking errors of paired runs `(scenarios x seeds,)` with a candidate and with the
    incumbent, and breaches' shares.

    An error is a mean square, of a robot in squares of each joint's `amplitude` `(joints,)`.
    """

    candidate: Array
    incumbent: Array
    breaches: tuple[float, float]
    amplitude: tuple[float, ...]

    def change_ci95(self) -> tuple[float, float] | None:
        """The bootstrap interval of the paired difference over runs, relative to the incumbent's
        mean; None where runs ran away."""
        rng = np.random.default_rng(0)
        drawn = rng.integers(0, len(self.candidate), (RESAMPLES, len(self.candidate)))
        with np.errstate(invalid="ignore"):
            change = (self.candidate - self.incumbent)[drawn].mean(axis=1) / max(
                float(self.incumbent.mean()), 1e-300
            )
            low, high = (float(np.quantile(change, q)) for q in (0.025, 0.975))
        return (low, high) if isfinite(low) and isfinite(high) else None

    def document(self) -> dict[str, Json]:
        """Both means, the paired difference relative to the incumbent's with a bootstrap interval,
        breaches, and what the figures can show."""
        base = max(float(self.incumbent.mean()), 1e-300)
        numbers = {
            "candidate": float(self.candidate.mean()),
            "incumbent": float(self.incumbent.mean()),
            "change": float((self.candidate - self.incumbent).mean() / base),
        }
        finite: dict[str, Json] = {name: x if isfinite(x) else None for name, x in numbers.items()}
        return {
            "stage": "MIL",
            "runs": len(self.candidate),
            "amplitude": self.amplitude[0] if len(self.amplitude) == 1 else list(self.amplitude),
            **finite,
            "change_ci95": None if (change := self.change_ci95()) is None else list(change),
            "breaches": {"candidate": self.breaches[0], "incumbent": self.breaches[1]},
            "shows": (
                "what either model does to the fixed planner on the machine as it was diagnosed"
            ),
            "cannot_show": CANNOT,
        }


def compare(
    machine: Corrected,
    candidate: Predictor,
    incumbent: Predictor,
    travelled: Travelled,
    progress: Callable[[float], None] = lambda _: None,
) -> Tracking:
    """Paired runs of both models on a machine that a diagnosis described, within the recorded
    ranges and the envelope. Raises NotIdentifiable where a joint is not commanded."""
    plant, joints = machine.plant, len(machine.plant.joints)
    if (plant.command_columns < 0).any():
        raise NotIdentifiable(
            "a joint without a command cannot follow anything",
            hint="Leave closed-loop rules out of this plant's gates.",
        )
    if not travelled.moved.any():
        raise NotIdentifiable(
            "no joint of the robot moved", hint="Hold out an episode in which the joints move."
        )
    low, high = _allowed(plant, travelled)
    middle, amplitude = (
        (low + high) / 2.0,
        SHARE * np.where(travelled.moved, (high - low) / 2.0, 0.0),
    )
    # what never moved is held still
    scale = np.where(travelled.moved, amplitude, amplitude[travelled.moved].mean())
    every = max(1, round(plant.horizon_s / TICKS_A_HORIZON / plant.timestep_s))
    t_s = np.arange(TICKS) * every * plant.timestep_s
    fastest = (
        1.0
        if joints == 1
        else min(
            1.0,
            _slowest(amplitude[travelled.moved], travelled.speed[travelled.moved])
            * plant.horizon_s
            / TURNS[-1],
        )
    )
    errors: dict[str, list[float]] = {"candidate": [], "incumbent": []}
    outside: dict[str, list[float]] = {"candidate": [], "incumbent": []}
    models: Mapping[str, Predictor] = {"candidate": candidate, "incumbent": incumbent}
    total = len(TURNS) * SEEDS * len(models)
    for turns in TURNS:
        wave = np.sin(2.0 * np.pi * fastest * turns / plant.horizon_s * t_s)
        reference = middle + amplitude * wave[:, None]
        for seed in range(SEEDS):
            for name, model in models.items():
                rng = np.random.default_rng(seed)
                begin = np.zeros(2 * joints)
                if joints > 1:  # what chance decides of a planner that does not draw
                    begin[:joints] = middle + BEGINS * amplitude * rng.uniform(-1.0, 1.0, joints)
                run = _run(machine, _planner(model, scale, every), reference, every, begin, rng)
                errors[name].append(
                    run.tracking_error(reference, np.ones(1) if joints == 1 else scale)
                )
                outside[name].append(run.breaches(plant))
                progress(sum(len(e) for e in errors.values()) / total)
    shares = float(np.mean(outside["candidate"])), float(np.mean(outside["incumbent"]))
    return Tracking(
        np.array(errors["candidate"]),
        np.array(errors["incumbent"]),
        shares,
        tuple(map(float, amplitude)),
    )


def _allowed(plant: Plant, travelled: Travelled) -> tuple[Array, Array]:
    """The range of each joint's references, `(joints,)` each: the envelope, and for a robot also
    the recorded range."""
    low, high = travelled.low.copy(), travelled.high.copy()
    for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
        if column < len(plant.joints) and channel.name in plant.envelope:
            near, far = plant.envelope[channel.name]
            one = len(plant.joints) == 1
            low[column], high[column] = (
                (near, far) if one else (max(near, low[column]), min(far, high[column]))
            )
    return low, high


def _slowest(amplitude: Array, speed: Array) -> float:
    """The frequency [Hz] at which no joint moves faster than it was recorded."""
    return float(np.min(speed / (2.0 * np.pi * amplitude)))


def _planner(model: Predictor, scale: Array, every: int) -> Planner:
    if len(scale) > 1:
        return Linearised(model, tuple(map(float, scale)), hold=every)
    limit = float(np.min(np.abs(model.plant.limits)))
    return RandomShooting(model, limit, effort=EFFORT * float(scale[0]) ** 2 / limit**2, hold=every)


def _run(
    machine: Corrected,
    planner: Planner,
    reference: Array,
    every: int,
    begin: Array,
    rng: np.random.Generator,
) -> LoopRun:
    """One run from rest. The planner sees the output of the machine's sensors, and the machine
    keeps the states of its effects. Observations are rolled forward through the commands under way,
    over the delay that the planner's own model has."""
    plant, joints = machine.plant, len(machine.plant.joints)
    samples = len(reference) * every + 1
    t_s = np.asarray(np.arange(samples) * plant.timestep_s, np.float64)
    lanes = np.repeat(np.array(machine.values)[:, None], BLOCK, axis=1)
    on, init = switches(machine.hypothesis, joints), np.repeat(begin[None, :, None], BLOCK, axis=2)
    issued, applied = (
        np.zeros((len(reference), len(plant.layout.commands))),
        np.zeros((samples, joints)),
    )
    states = np.zeros((len(reference) + 1, 2 * joints))
    states[0] = begin
    estimator, late_s = Estimator(planner.predictor), transport_delay_s(planner.predictor)
    # when what is commanded shows
    ticks = np.arange(len(reference)) + late_s / (every * plant.timestep_s)
    aims = np.stack([np.interp(ticks, np.arange(len(reference)), r) for r in reference.T], axis=1)
    for tick in range(len(reference)):
        now, then = tick * every, (tick + 1) * every
        estimator.observed(t_s[now], states[tick])
        issued[tick] = planner.plan(estimator.state(t_s[now] + late_s), aims[tick:], rng)
        estimator.commanded(t_s[now] + late_s, issued[tick])
        applied[now : then + 1] = plant.applied(issued[tick])
        series = unobserved(
            machine.scheme,
            t_s[: then + 1],
            applied[: then + 1],
            plant.command_scales,
            plant.timestep_s,
        )
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # a loop that runs away ends as inf, and no rule passes that
            states[tick + 1] = roll(series, plant.form, lanes, on, init)[-1, :, 0]
    return LoopRun(states, issued)
