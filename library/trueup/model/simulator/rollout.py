"""The rollout of a simulator of the user's own over episodes, in numpy.

It gives what the compiled rollout (`kernel.py`) gives: an episode runs through, position and
velocity are set where a window starts, hidden states keep their past. A call of numpy costs as much
for one lane as for many, so all windows of all episodes are stepped side by side. Where something
remembers, windows are rolled out from what is known of their past, and once more where that turns
out to have been another.

Where there is a filter, it runs over the episodes first, and windows start from it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.block import Block
from trueup.model.effect import Port
from trueup.model.series import Series
from trueup.model.simulator.filter import filtered
from trueup.model.simulator.run import Run
from trueup.model.simulator.sensors import followed, shown
from trueup.model.simulator.simulator import Simulator
from trueup.model.simulator.step import Memory, SimulatedStep
from trueup.model.simulator.timeline import Acting, Timeline, acting_at, commanded, sensor_is_late
from trueup.model.stack import RolloutOf

Array = NDArray[np.float64]

# Short calls of numpy, or of an ONNX runtime, in two threads wait for Python's lock more than they
# gain: on two cores a diagnosis took 1.1 to 1.2 times as long, and 1.2 to 1.3 times the CPU.
_ONE_AT_A_TIME = Lock()


def roll_simulator(
    simulator: Simulator,
    sizes: Array,
    block: Block,
    on: NDArray[np.uint8],
    asked: RolloutOf,
) -> list[Array]:
    """What is observed in each series of a stack, `(samples, 2 x joints, lanes)`."""
    lanes, kept = _distinct(asked)
    # running away is an answer: it ends as inf or nan
    with _ONE_AT_A_TIME, np.errstate(all="ignore"):
        runs = _runs(simulator, sizes, block, on, asked, kept)
        out = _filtered(runs) if asked.gains is not None else _remembered(runs)
    return [one[:, :, lanes] for one in out]


def _distinct(asked: RolloutOf) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each lane the one of those that are kept that is like it, and those that are kept: the
    first, in a filter's rollout the second, and all that differ from it."""
    like = 0 if asked.gains is None else 1
    count = asked.p.shape[2]
    differs = np.zeros(count, np.bool_)
    for table in (asked.p, asked.init):
        differs |= (table != table[:, :, like : like + 1]).any(axis=(0, 1))
    differs[: like + 1] = True
    kept = np.flatnonzero(differs)
    at = np.full(count, like)
    at[kept] = np.arange(len(kept))
    return at, kept


def _runs(
    simulator: Simulator,
    sizes: Array,
    block: Block,
    on: NDArray[np.uint8],
    asked: RolloutOf,
    kept: NDArray[np.int64],
) -> list[Run]:
    series = asked.stack.series
    timelines = [Timeline.of(s) for s in series]
    parameters, init = asked.p[:, :, kept], asked.init[:, :, kept]
    starts = np.split(init, len(series)) if asked.gains is not None else asked.stack.split(init)
    acting = [acting_at(on, block, p) for p in parameters]
    reached = commanded(series, timelines, acting, len(kept))
    following = int(np.searchsorted(kept, asked.starts, side="right")) - 1
    # of filters one alone
    gain = None if asked.gains is None else asked.gains[..., 0]
    by_episode = zip(series, parameters, starts, timelines, acting, reached, strict=True)
    return [
        _run(simulator, sizes, s, p, begins, timeline, effects, commands, following, gain)
        for s, p, begins, timeline, effects, commands in by_episode
    ]


def _run(
    simulator: Simulator,
    sizes: Array,
    s: Series,
    p: Array,
    init: Array,
    timeline: Timeline,
    acting: Sequence[Acting],
    reached: tuple[Array, Array],
    following: int,
    gain: Array | None,
) -> Run:
    lanes = p.shape[1]
    by_port = {port: [x for x in acting if x.effect.port is port] for port in Port}
    commands, h_s = reached
    step = SimulatedStep(
        simulator,
        {name: p[i] for i, name in enumerate(simulator.parameters)},
        by_port[Port.FORCE],
        by_port[Port.FRICTION],
        sizes,
        s.scheme.alpha,
        s.u_scale,
        np.full(lanes, s.period_s),
        frozenset(
            x
            for port in (Port.FORCE, Port.FRICTION)
            for one_acting in by_port[port]
            for x in one_acting.effect.arguments()
        ),
    )
    if gain is not None:  # windows start from the filter
        init = np.repeat(init[:1], len(timeline.starts), axis=0)
    elif len(timeline.starts) > len(init):  # samples before the first window
        init = np.concatenate([np.zeros((1, *init.shape[1:])), init])
    sensors = [x for x in by_port[Port.OBSERVATION] if not x.effect.delays()]
    late_s = np.zeros((simulator.joints, lanes))
    for x in acting:
        if sensor_is_late(x, simulator.joints):
            given = {"lag_s": late_s[x.joint], "period": s.period_s}
            late_s[x.joint] = x.value(given, x.begin(0.0, lanes))[0]
    return Run(s, timeline, step, sensors, late_s, commands, h_s, init, following, gain)


@dataclass(slots=True, eq=False)
class _Window:
    """A window of a run: the step at which it begins, how many it has, and from where."""

    run: Run
    number: int
    first: int
    steps: int
    hidden: Array
    memory: Memory
    path: Array  # `(steps + 1, lanes, 2 x joints)`
    after: tuple[Array, Memory] | None = None  # what is hidden at its end


def _windows(run: Run) -> list[_Window]:
    hidden, memory = run.begin()
    first = run.timeline.first
    bounds = zip(run.timeline.starts, run.ends, strict=True)
    return [
        _Window(
            run,
            w,
            int(first[a]),
            int(first[b] - first[a]),
            hidden,
            memory,
            np.empty((int(first[b] - first[a]) + 1, run.lanes, run.step.simulator.motion)),
        )
        for w, (a, b) in enumerate(bounds)
    ]


def _remembered(runs: Sequence[Run]) -> list[Array]:
    """What is observed, with hidden states that run through."""
    by_run = [_windows(run) for run in runs]
    todo = [w for windows in by_run for w in windows]
    while todo:
        _roll_side_by_side(todo)
        todo = [w for windows in by_run for w in _began_otherwise(windows)]
    return [shown(run, *_states(run, windows)) for run, windows in zip(runs, by_run, strict=True)]


def _began_otherwise(windows: Sequence[_Window]) -> Iterator[_Window]:
    """The windows that begin with another past than they were rolled out from, which is set."""
    for before, window in pairwise(windows):
        assert before.after is not None
        hidden = followed(before.after[0], window.run.following)
        memory = {k: followed(x, window.run.following) for k, x in before.after[1].items()}
        if not (
            np.array_equal(hidden, window.hidden, equal_nan=True)
            and all(np.array_equal(memory[k], window.memory[k], equal_nan=True) for k in memory)
        ):
            window.hidden, window.memory = hidden, memory
            yield window


def _roll_side_by_side(windows: Sequence[_Window]) -> None:
    """Roll out windows, all at once."""
    ordered = sorted(windows, key=lambda w: -w.steps)
    simulator = ordered[0].run.step.simulator
    motion = simulator.motion
    lanes, counts = ordered[0].run.lanes, np.array([w.steps for w in ordered])
    state = np.concatenate(
        [np.concatenate([w.run.init[w.number].T, w.hidden], axis=1) for w in ordered]
    )
    keys = list(ordered[0].memory)
    memory = {key: np.concatenate([w.memory[key] for w in ordered]) for key in keys}
    step = SimulatedStep.side_by_side([w.run.step for w in ordered])
    longest = int(counts[0])
    u = np.zeros((longest, len(ordered), lanes, simulator.joints))
    h_s, t_s = (np.zeros((longest, len(ordered), lanes)) for _ in range(2))
    for i, w in enumerate(ordered):
        part = slice(w.first, w.first + w.steps)
        u[: w.steps, i] = w.run.commands[part].transpose(0, 2, 1)
        h_s[: w.steps, i] = w.run.h_s[part]
        t_s[: w.steps, i] = w.run.timeline.begins_s[part, None]
    by_step = [x.reshape(longest, len(state), *x.shape[3:]) for x in (u, h_s, t_s)]
    path = np.empty((longest + 1, len(state), motion))
    path[0] = state[:, :motion]
    running = len(ordered)
    # of each step the windows that have more than so many
    still_run = np.searchsorted(-counts, -np.arange(longest), side="left").tolist()
    for k, still in enumerate(still_run):
        if still < running:
            _end(ordered[still:running], state[still * lanes :], memory, still * lanes, lanes)
            running, many = still, still * lanes
            state, step = state[:many], step.at(slice(many))
            memory = {key: x[:many] for key, x in memory.items()}
        many = running * lanes
        u_now, h_now, t_now = (x[k, :many] for x in by_step)
        state, memory = step.advance(state, u_now, h_now, t_now, memory)
        path[k + 1, :many] = state[:, :motion]
    _end(ordered[:running], state, memory, 0, lanes)
    by_window = path.reshape(longest + 1, len(ordered), lanes, motion)
    for i, w in enumerate(ordered):
        w.path[:] = by_window[: w.steps + 1, i]


def _end(
    windows: Sequence[_Window], state: Array, memory: Mapping[Any, Array], at: int, lanes: int
) -> None:
    """Keep what is hidden at the end of windows that are through."""
    for i, w in enumerate(windows):
        part = slice(i * lanes, (i + 1) * lanes)
        behind = slice(at + part.start, at + part.stop)
        w.after = (
            state[part, w.run.step.simulator.motion :].copy(),
            {key: x[behind].copy() for key, x in memory.items()},
        )


def _states(run: Run, windows: Sequence[_Window]) -> tuple[Array, Array]:
    """Positions and velocities at each sample `(samples, 2 x joints, lanes)`, and the velocities
    with which the windows before a start ended, `(windows, lanes, joints)`."""
    joints, motion = run.step.simulator.joints, run.step.simulator.motion
    states = np.empty((len(run.series.t_s), motion, run.lanes))
    for w, a, b in zip(windows, run.timeline.starts, run.ends, strict=True):
        at = run.timeline.first[a : b + 1] - w.first
        states[a : b + 1] = w.path[at].transpose(0, 2, 1)
    ended = np.stack(
        [np.zeros((run.lanes, joints)), *(w.path[-1, :, joints:] for w in windows[:-1])]
    )
    return states, ended


def _filtered(runs: Sequence[Run]) -> list[Array]:
    """What is observed of lanes that start each window from a filter in lane 0."""
    by_run = [_windows(run) for run in runs]
    followed = filtered(runs, [run.begin() for run in runs])
    for windows, follows in zip(by_run, followed, strict=True):
        run, motion = windows[0].run, windows[0].run.step.simulator.motion
        for w, sample in zip(windows, run.timeline.starts, strict=True):
            run.init[w.number] = follows.states[sample, :motion, None]
            w.hidden = np.tile(follows.states[sample, motion:], (run.lanes, 1))
            w.memory = {
                key: np.full(run.lanes, x[sample])
                for key, x in follows.memory.items()
                if key in w.memory
            }
    _roll_side_by_side([w for windows in by_run for w in windows])
    out = []
    for run, windows, follows in zip(runs, by_run, followed, strict=True):
        starts = run.timeline.starts
        sees = shown(run, *_states(run, windows), follows)
        sees[starts] = follows.shown[starts, :, None]
        sees[:, :, 0] = follows.shown
        out.append(sees)
    return out
