"""Timeline: an episode's steps between its samples, and the commands that reach the joints in each.

Commands depend on nothing that moves, so what acts on them is worked out for a whole episode, ahead
of any rollout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
SIGNAL = {Port.TIMING: "h", Port.COMMAND: "u", Port.FORCE: "a", Port.FRICTION: "level"}


@dataclass(frozen=True, slots=True, eq=False)
class Acting:
    """An effect that acts at a joint, with its numbers `(lanes,)` by name, and how far from its
    usual value each of its hidden states began."""

    effect: type[Effect]
    joint: int
    numbers: Mapping[str, Array]
    began: Mapping[str, Array]

    @property
    def keys(self) -> list[tuple[str, str]]:
        """What its hidden states are called among all: by its term, and their names."""
        at = term(self.effect.name, self.joint)
        return [(at, state) for state in self.effect.states]

    def value(self, signals: Mapping[str, Any], memory: Mapping[Any, Any]) -> tuple[Any, ...]:
        """What the effect returns: its port's signal, then its states. Raises BadEffect."""
        at, numbers = dict(zip(self.effect.states, self.keys, strict=True)), self.numbers
        given = (
            numbers[x] if x in numbers else memory[at[x]] if x in at else signals[x]
            for x in self.effect.arguments()
        )
        try:
            after = self.effect.apply(*given)
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
    s: Series, timeline: Timeline, acting: Sequence[Acting], lanes: int
) -> tuple[Array, Array]:
    """The commands that reach the joints in each step `(steps, joints, lanes)`, and its length [s]
    `(steps, lanes)`."""
    shape = len(timeline.h_s), lanes
    signals: dict[str, Any] = {
        "h": np.broadcast_to(timeline.h_s[:, None], shape),
        "t": timeline.begins_s[:, None],
        "period": s.period_s,
        "implicit": 1.0 - 2.0 * s.scheme.alpha,
    }
    for one in acting:
        if one.effect.port is Port.TIMING:  # one clock for all joints
            signals["h"] = _in_turn(one, signals, s, lanes)
    h_s = np.asarray(np.broadcast_to(signals["h"], shape))
    joints = s.issued.shape[1]
    commands = np.empty((shape[0], joints, lanes))
    for j in range(joints):
        at_joint = [one for one in acting if one.joint == j]
        late_s, past = _late(s, j, at_joint, lanes)
        signals["u_scale"] = float(s.u_scale[j])
        signals["u"] = _delayed(s, timeline, j, late_s, past)
        for one in at_joint:
            if one.effect.port is Port.COMMAND and not one.effect.delays():
                signals["u"] = _in_turn(one, signals, s, lanes)
        commands[:, j] = signals["u"]
    return commands, h_s


def _in_turn(one: Acting, signals: Mapping[str, Any], s: Series, lanes: int) -> Array:
    """An effect's signal after it has acted in every step, one after the other where it
    remembers."""
    if not one.effect.states:
        return np.asarray(one.value(signals, {})[0])
    memory = one.begin(s.issued[0, one.joint], lanes)
    signal = signals[SIGNAL[one.effect.port]]
    after = np.empty(np.broadcast_shapes(np.shape(signal), (1, lanes)))
    changing = [k for k, x in signals.items() if np.ndim(x) == 2]  # noqa: PLR2004  (steps by lanes)
    now = dict(signals)
    for i in range(len(after)):
        for k in changing:
            now[k] = signals[k][i]
        after[i], *states = one.value(now, memory)
        memory = dict(zip(one.keys, states, strict=True))
    return after


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
