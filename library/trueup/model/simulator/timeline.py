"""Timeline: an episode's steps between its samples, and the command that reaches a joint in each.

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
from trueup.model.block import Block, memory_offsets, offsets
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
    """An effect that acts, with its numbers `(lanes,)` by name, and how far from its usual value
    each of its hidden states began."""

    effect: type[Effect]
    numbers: Mapping[str, Array]
    began: Mapping[str, Array]

    def value(self, signals: Mapping[str, Any], memory: Mapping[Any, Any]) -> tuple[Any, ...]:
        """What the effect returns: its port's signal, then its states. Raises BadEffect."""
        name, numbers = self.effect.name, self.numbers
        given = (
            numbers[x]
            if x in numbers
            else memory[name, x]
            if x in self.effect.states
            else signals[x]
            for x in self.effect.arguments()
        )
        try:
            after = self.effect.apply(*given)
        except ValueError as error:
            raise BadEffect(
                f"{name} does not run on arrays: {error}",
                hint="Write it with numpy's functions: np.maximum, np.where.",
            ) from error
        return after if isinstance(after, tuple) else (after,)

    def at(self, lanes: Any) -> Acting:
        """The effect in some of the lanes."""
        numbers, began = (
            {k: x[lanes] for k, x in table.items()} for table in (self.numbers, self.began)
        )
        return Acting(self.effect, numbers, began)

    @staticmethod
    def side_by_side(each: Sequence[Acting]) -> Acting:
        """One effect in the lanes of several."""
        numbers, began = (
            {k: np.concatenate([table[k] for table in tables]) for k in tables[0]}
            for tables in ([x.numbers for x in each], [x.began for x in each])
        )
        return Acting(each[0].effect, numbers, began)

    def begin(self, command: Any, lanes: int) -> dict[tuple[str, str], Array]:
        """What the effect remembers at the beginning, `(lanes,)` each, under a first command,
        one for all or `(lanes,)`."""
        usual = {"zero": 0.0, "first": 0.0, "u": command}
        return {
            (self.effect.name, state): np.full(lanes, usual[begins]) + self.began.get(state, 0.0)
            for state, begins in zip(self.effect.states, self.effect.begins, strict=True)
        }


def acting_at(on: NDArray[np.uint8], block: Block, p: Array) -> list[Acting]:
    """The effects that act, in their order, with their numbers from a block's lanes `(rows,
    lanes)`. Raises BadEffect where one asks for what no simulator gives."""
    acting = []
    for effect, acts in zip(effects().values(), on[:, 0], strict=True):
        if not acts:
            continue
        names = [n.name for n in effect.params]
        own = {*names, *effect.states}
        unknown = [x for x in effect.arguments() if x not in own | KNOWN[effect.port]]
        if unknown:
            raise BadEffect(
                f"{effect.name} asks for {unknown[0]}, which a simulator does not give at the "
                f"port {effect.port}"
            )
        rows = [block.nominal + row for row in offsets()[effect.name]]
        began = {
            state: p[block.nominal + memory_offsets()[effect.name, state]]
            for state in effect.states
            if (effect.name, state) in memory_offsets()
        }
        numbers = {name: p[row] for name, row in zip(names, rows, strict=True)}
        acting.append(Acting(effect, numbers, began))
    return acting


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """The steps of a series, one after the other. `first` `(samples,)` is the step that begins at
    each sample; `begins_s`, `h_s` `(steps,)` when each begins and how long it is [s]; `issued`
    `(steps,)` the command meanwhile. `starts` `(windows,)` are the samples at which windows start,
    the first of all with what lies before them."""

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
            s.issued[at, 0] + s.rise[at, 0] * middle,
            starts if starts[0] == 0 else np.concatenate([[0], starts]),
        )


def commanded(
    s: Series, timeline: Timeline, acting: Sequence[Acting], lanes: int
) -> tuple[Array, Array]:
    """The command that reaches the joint, and the length [s], of each step, `(steps, lanes)`
    each."""
    shape = len(timeline.h_s), lanes
    signals: dict[str, Any] = {
        "h": np.broadcast_to(timeline.h_s[:, None], shape),
        "t": timeline.begins_s[:, None],
        "period": s.period_s,
        "implicit": 1.0 - 2.0 * s.scheme.alpha,
        "u_scale": float(s.u_scale[0]),
    }
    late_s, past = _late(s, acting, lanes)
    issued = np.broadcast_to(timeline.issued[:, None], shape)
    signals["u"] = _delayed(s, timeline, issued, late_s, past)
    for port in (Port.TIMING, Port.COMMAND):
        for one in acting:
            if one.effect.port is port and not one.effect.delays():
                signals[SIGNAL[port]] = _in_turn(one, signals, SIGNAL[port], s, lanes)
    return np.asarray(signals["u"]), np.asarray(np.broadcast_to(signals["h"], shape))


def _in_turn(one: Acting, signals: Mapping[str, Any], signal: str, s: Series, lanes: int) -> Array:
    """An effect's signal after it has acted in every step, one after the other where it
    remembers."""
    if not one.effect.states:
        return np.asarray(one.value(signals, {})[0])
    memory = one.begin(s.issued[0, 0], lanes)
    keys = list(memory)
    after = np.empty(np.broadcast_shapes(np.shape(signals[signal]), (1, lanes)))
    changing = [k for k, x in signals.items() if np.ndim(x) == 2]  # noqa: PLR2004  (steps by lanes)
    now = dict(signals)
    for i in range(len(after)):
        for k in changing:
            now[k] = signals[k][i]
        after[i], *states = one.value(now, memory)
        memory = dict(zip(keys, states, strict=True))
    return after


def _late(s: Series, acting: Sequence[Acting], lanes: int) -> tuple[Array, Array]:
    """By how much the command is late in all [s], and what it was before the log, `(lanes,)` each:
    on the log of one joint a late sensor is a late drive."""
    late_s, past = np.zeros(lanes), np.zeros(lanes)
    for one in acting:
        if one.effect.delays():
            memory = one.begin(s.issued[0, 0], lanes)
            late_s = one.value({"lag_s": late_s, "period": s.period_s}, memory)[0]
            if memory and one.effect.port is Port.COMMAND:
                past = next(iter(memory.values()))
    return late_s, past


def _delayed(s: Series, timeline: Timeline, issued: Array, late_s: Array, past: Array) -> Array:
    """The mean over each step of a command that is late."""
    if not (late_s > 0.0).any():
        return issued
    ends = timeline.begins_s + timeline.h_s
    reached = []
    for when in (timeline.begins_s[:, None] - late_s, ends[:, None] - late_s):
        k = np.clip(np.searchsorted(s.t_s, when, side="right") - 1, 0, len(s.t_s) - 1)
        command = np.where(when >= s.t_s[0], s.issued[k, 0], past)
        reached.append(s.integral[k, 0] + command * (when - s.t_s[k]))
    mean = (reached[1] - reached[0]) / timeline.h_s[:, None]
    return np.asarray(np.where(late_s > 0.0, mean, issued))
