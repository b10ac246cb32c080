"""Timeline: an episode's steps between its samples, and the commands that reach the joints in each.

Commands depend on nothing that moves, so what acts on them is worked out for a whole episode, ahead
of any rollout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadEffect
from trueup.model.block import Block, term
from trueup.model.effect import Effect, Port, effects
from trueup.model.series import Series

Array = NDArray[np.float64]
Index = NDArray[np.int64]
# what an effect may ask for at a port where the nominal model is a simulator
KNOWN = {
    Port.TIMING: {"h", "period", "t"},
    Port.COMMAND: {"u", "h", "implicit", "u_scale", "period", "lag_s", "t"},
    Port.FORCE: {
        "a", "q", "v", "h", "implicit", "passive", "drive", "spring", "mobility", "period", "u",
        "u_scale", "t",
    },
    Port.FRICTION: {"q", "v", "h", "drive", "passive", "spring", "u", "u_scale", "t"},
    Port.OBSERVATION: {"q", "v", "t", "since", "period", "lag_s", "u_scale"},
}  # fmt: skip
NUMBERS, MEMORY, SIGNALS = range(3)  # where an argument of an effect stands
SIGNAL = {Port.TIMING: "h", Port.COMMAND: "u", Port.FORCE: "a", Port.FRICTION: "level"}


@dataclass(frozen=True, eq=False)
class Acting:
    """An effect that acts at a joint, with its numbers `(lanes,)` by name, and how far from its
    usual value each of its hidden states began."""

    effect: type[Effect]
    joint: int
    numbers: Mapping[str, Array]
    began: Mapping[str, Array]

    @cached_property
    def keys(self) -> list[tuple[str, str]]:
        """What its hidden states are called among all: by its term, and their names."""
        at = term(self.effect.name, self.joint)
        return [(at, state) for state in self.effect.states]

    @cached_property
    def asks(self) -> list[tuple[int, Any]]:
        """Where each argument stands, among the numbers, in what is remembered or among the
        signals, and by which key."""
        at = dict(zip(self.effect.states, self.keys, strict=True))
        return [
            (NUMBERS, x) if x in self.numbers else (MEMORY, at[x]) if x in at else (SIGNALS, x)
            for x in self.effect.arguments()
        ]

    def value(self, signals: Mapping[str, Any], memory: Mapping[Any, Any]) -> tuple[Any, ...]:
        """What the effect returns: its port's signal, then its states. Raises BadEffect."""
        tables = self.numbers, memory, signals
        try:
            after = self.effect.apply(*[tables[table][key] for table, key in self.asks])
        except ValueError as error:
            raise BadEffect(
                f"{self.effect.name} does not run on arrays: {error}",
                hint="Write it with numpy's functions: np.maximum, np.where.",
            ) from error
        return after if isinstance(after, tuple) else (after,)

    def at(self, lanes: Any) -> Acting:
        """The effect in some of the lanes."""
        numbers, began = (
            {k: x[lanes] for k, x in table.items()} for table in (self.numbers, self.began)
        )
        return Acting(self.effect, self.joint, numbers, began)

    @staticmethod
    def side_by_side(each: Sequence[Acting]) -> Acting:
        """One effect in the lanes of several."""
        numbers, began = (
            {k: np.concatenate([table[k] for table in tables]) for k in tables[0]}
            for tables in ([x.numbers for x in each], [x.began for x in each])
        )
        return Acting(each[0].effect, each[0].joint, numbers, began)

    def begin(self, command: Any, lanes: int) -> dict[tuple[str, str], Array]:
        """What the effect remembers at the beginning, `(lanes,)` each, under a first command,
        one for all or `(lanes,)`."""
        usual = {"zero": 0.0, "first": 0.0, "u": command}
        return {
            key: np.full(lanes, usual[begins]) + self.began.get(key[1], 0.0)
            for key, begins in zip(self.keys, self.effect.begins, strict=True)
        }


def acting_at(on: NDArray[np.uint8], block: Block, p: Array) -> list[Acting]:
    """The effects that act, joint by joint in their order, with their numbers from a block's lanes
    `(rows, lanes)`. Raises BadEffect where one asks for what no simulator gives."""
    return [
        _acting(effect, joint, block, p)
        for joint in range(block.joints)
        for effect, acts in zip(effects().values(), on[:, joint], strict=True)
        if acts
    ]


def _acting(effect: type[Effect], joint: int, block: Block, p: Array) -> Acting:
    own, at = {n.name for n in effect.params} | {*effect.states}, term(effect.name, joint)
    unknown = [x for x in effect.arguments() if x not in own | KNOWN[effect.port]]
    if unknown:
        raise BadEffect(
            f"{effect.name} asks for {unknown[0]}, which a simulator does not give at the "
            f"port {effect.port}"
        )
    began = {
        state: p[block.memories[at, state]]
        for state in effect.states
        if (at, state) in block.memories
    }
    return Acting(effect, joint, {n: p[row] for n, row in block.rows_of(at).items()}, began)


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """The steps of a series, one after the other. `first` `(samples,)` is the step that begins at
    each sample; `begins_s`, `h_s` `(steps,)` when each begins and how long it is [s]; `issued`
    `(steps, joints)` the commands meanwhile. `starts` `(windows,)` are the samples at which windows
    start, the first of all with what lies before them."""

    first: Index
    begins_s: Array
    h_s: Array
    issued: Array
    starts: Index

    @staticmethod
    def of(s: Series) -> Timeline:
        """The steps of a series."""
        first = np.concatenate([[0], np.cumsum(s.steps[:-1])])
        at = np.repeat(np.arange(len(s.t_s)), s.steps)
        step = np.arange(len(at)) - first[at]
        middle = (step + 0.5) / s.steps[at] - 0.5
        starts = np.flatnonzero(s.resets >= 0)
        return Timeline(
            first,
            s.t_s[at] + step * s.h_s[at],
            s.h_s[at],
            s.issued[at] + s.rise[at] * middle[:, None],
            starts if starts[0] == 0 else np.concatenate([[0], starts]),
        )


def commanded(
    series: Sequence[Series],
    timelines: Sequence[Timeline],
    acting: Sequence[Sequence[Acting]],
    lanes: int,
) -> list[tuple[Array, Array]]:
    """For each series, of which the same effects are `acting`, the commands that reach the joints
    in each step `(steps, joints, lanes)`, and its length [s] `(steps, lanes)`."""
    shapes = [(len(timeline.h_s), lanes) for timeline in timelines]
    signals: list[dict[str, Any]] = [
        {
            "h": np.broadcast_to(timeline.h_s[:, None], shape),
            "t": timeline.begins_s[:, None],
            "period": s.period_s,
            "implicit": 1.0 - 2.0 * s.scheme.alpha,
        }
        for s, timeline, shape in zip(series, timelines, shapes, strict=True)
    ]

    def act(port: Port, joints: Sequence[int]) -> None:
        for each in zip(*acting, strict=True):
            first = each[0]
            if first.effect.port is port and first.joint in joints and not first.effect.delays():
                for now, after in zip(signals, _in_turn(each, signals, series, lanes), strict=True):
                    now[SIGNAL[port]] = after

    joints = series[0].issued.shape[1]
    act(Port.TIMING, range(joints))  # one clock for all joints
    commands = [np.empty((shape[0], joints, lanes)) for shape in shapes]
    for j in range(joints):
        for s, timeline, each, now in zip(series, timelines, acting, signals, strict=True):
            late_s, past = _late(s, j, [one for one in each if one.joint == j], lanes)
            now["u_scale"] = float(s.u_scale[j])
            now["u"] = _delayed(s, timeline, j, late_s, past)
        act(Port.COMMAND, [j])
        for into, now in zip(commands, signals, strict=True):
            into[:, j] = now["u"]
    lengths = [
        np.asarray(np.broadcast_to(now["h"], shape))
        for now, shape in zip(signals, shapes, strict=True)
    ]
    return list(zip(commands, lengths, strict=True))


def _in_turn(
    each: Sequence[Acting],
    signals: Sequence[Mapping[str, Any]],
    series: Sequence[Series],
    lanes: int,
) -> list[Array]:
    """An effect's signal in each series after it has acted in every step; one step after the other
    where it remembers, of all series side by side."""
    if not each[0].effect.states:
        return [np.asarray(one.value(x, {})[0]) for one, x in zip(each, signals, strict=True)]
    one = Acting.side_by_side(each)
    memories = [x.begin(s.issued[0, x.joint], lanes) for x, s in zip(each, series, strict=True)]
    memory = {key: np.concatenate([m[key] for m in memories]) for key in one.keys}
    counts = [len(x[SIGNAL[one.effect.port]]) for x in signals]
    changing = {
        key: _side_by_side([x[key] for x in signals], counts, lanes)
        for stands, key in one.asks
        if stands == SIGNALS
    }
    after = np.empty((max(counts), len(each) * lanes))
    for i in range(len(after)):
        after[i], *states = one.value({key: x[i] for key, x in changing.items()}, memory)
        memory = dict(zip(one.keys, states, strict=True))
    return [after[:n, k * lanes : (k + 1) * lanes] for k, n in enumerate(counts)]


def _side_by_side(each: Sequence[Any], counts: Sequence[int], lanes: int) -> Array:
    """Signals of several series `(steps, lanes)`, or what broadcasts to it, in lanes side by side;
    the last of a shorter one is repeated."""
    out = np.empty((max(counts), len(each), lanes))
    for k, (x, n) in enumerate(zip(each, counts, strict=True)):
        out[:n, k] = x
        out[n:, k] = out[n - 1, k]
    return out.reshape(len(out), len(each) * lanes)


def sensor_is_late(one: Acting, joints: int) -> bool:
    """Whether an effect makes what a sensor shows late; on the log of one joint it is a late
    drive."""
    return joints > 1 and one.effect.delays() and one.effect.port is Port.OBSERVATION


def _late(s: Series, joint: int, acting: Sequence[Acting], lanes: int) -> tuple[Array, Array]:
    """By how much a joint's command is late in all [s], and what it was before the log, `(lanes,)`
    each."""
    late_s, past = np.zeros(lanes), np.zeros(lanes)
    for one in acting:
        if one.effect.delays() and not sensor_is_late(one, s.issued.shape[1]):
            memory = one.begin(s.issued[0, joint], lanes)
            late_s = one.value({"lag_s": late_s, "period": s.period_s}, memory)[0]
            if memory and one.effect.port is Port.COMMAND:
                past = next(iter(memory.values()))
    return late_s, past


def _delayed(s: Series, timeline: Timeline, joint: int, late_s: Array, past: Array) -> Array:
    """The mean over each step of a joint's command that is late, `(steps, lanes)`."""
    issued = np.broadcast_to(timeline.issued[:, joint, None], (len(timeline.h_s), len(late_s)))
    if not (late_s > 0.0).any():
        return issued
    ends = timeline.begins_s + timeline.h_s
    reached = []
    for when in (timeline.begins_s[:, None] - late_s, ends[:, None] - late_s):
        k = np.clip(np.searchsorted(s.t_s, when, side="right") - 1, 0, len(s.t_s) - 1)
        command = np.where(when >= s.t_s[0], s.issued[k, joint], past)
        reached.append(s.integral[k, joint] + command * (when - s.t_s[k]))
    mean = (reached[1] - reached[0]) / timeline.h_s[:, None]
    return np.asarray(np.where(late_s > 0.0, mean, issued))
