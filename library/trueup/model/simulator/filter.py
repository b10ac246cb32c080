"""The filter of a simulator's rollout: the model, corrected by each observation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.simulator.run import Run
from trueup.model.simulator.simulator import MOTION
from trueup.model.simulator.step import Memory, SimulatedStep
from trueup.model.simulator.timeline import Acting

Array = NDArray[np.float64]
FORCE = 2  # the row of a gain that corrects a disturbing acceleration
FIRST = slice(1)  # of a run's lanes: the filter's
HIDDEN = 3  # the row that corrects what hides the velocity


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """An episode as the filter follows it: its `states` `(samples, states)` and what effects
    remember `(samples,)`, once corrected; what it had `shown` before, `(samples, 2)`."""

    states: Array
    memory: Mapping[tuple[str, str], Array]
    shown: Array


def filtered(runs: Sequence[Run], begun: Sequence[tuple[Array, Memory]]) -> list[Followed]:
    """The filters of some episodes, all at once."""
    order = sorted(range(len(runs)), key=lambda i: -len(runs[i].series.t_s))
    followed = _Filters([runs[i] for i in order], [begun[i] for i in order]).run()
    return [followed[order.index(i)] for i in range(len(runs))]


class _Filters:
    """Filters of episodes, the longest first, a lane each."""

    def __init__(self, runs: Sequence[Run], begun: Sequence[tuple[Array, Memory]]) -> None:
        self.runs = runs
        self.samples = np.array([len(r.series.t_s) for r in runs])
        self.state = np.array(
            [
                np.concatenate([r.init[0, :, 0], hidden[0]])
                for r, (hidden, _) in zip(runs, begun, strict=True)
            ]
        )
        self.memory: dict[Any, Array] = {
            key: np.array([memory[key][0] for _, memory in begun]) for key in begun[0][1]
        }
        self.step = SimulatedStep.side_by_side([r.step.at(FIRST) for r in runs])
        self.sensors = [
            Acting.side_by_side([x.at(FIRST) for x in each])
            for each in zip(*(r.sensors for r in runs), strict=True)
        ]
        commands = np.array([r.series.issued[0, 0] for r in runs])
        for one in self.sensors:
            self.memory |= one.begin(commands, len(runs))
        self.push = np.zeros(len(runs))

    def run(self) -> list[Followed]:
        """Follow all episodes to their ends."""
        total = int(self.samples[0])
        states = np.zeros((total, *self.state.shape))
        seen = np.zeros((total, len(self.runs), MOTION))
        kept = {key: np.zeros((total, len(self.runs))) for key in self.memory}
        times = np.zeros((total, len(self.runs)))
        observed, usable = (np.zeros((total, len(self.runs), MOTION)) for _ in range(2))
        gains = np.zeros((total, len(self.runs), 4, 2))
        for r, run in enumerate(self.runs):
            n, gain = self.samples[r], run.gain
            assert gain is not None
            times[:n, r], observed[:n, r] = run.series.t_s, run.series.observed
            usable[:n, r] = run.series.usable
            gains[:n, r] = gain[np.minimum(np.arange(n), len(gain) - 1), 0]
        gains *= usable[:, :, None, :]
        for i in range(total):
            many = int(np.searchsorted(-self.samples, -i, side="left"))
            if many < len(self.push):
                self._only(slice(many))
            shown = self._observed(times[i, :many], times[i, :many] - times[max(i - 1, 0), :many])
            seen[i, :many] = shown
            self._correct(i, observed[i, :many] - shown, gains[i, :many], usable[i, :many])
            states[i, :many] = self.state
            for key, value in self.memory.items():
                kept[key][i, :many] = value
            self._advance(i, many)
        return [
            Followed(
                states[:n, r],
                {key: value[:n, r] for key, value in kept.items()},
                seen[:n, r],
            )
            for r, n in enumerate(self.samples)
        ]

    def _only(self, lanes: slice) -> None:
        self.state, self.push = self.state[lanes], self.push[lanes]
        self.memory = {key: value[lanes] for key, value in self.memory.items()}
        self.step = self.step.at(lanes)
        self.sensors = [one.at(lanes) for one in self.sensors]

    def _observed(self, t_s: Array, since: Array) -> Array:
        """What the sensors show now, `(lanes, 2)`."""
        signals: dict[str, Any] = {
            "q": self.state[:, 0],
            "v": self.state[:, 1],
            "t": t_s,
            "since": since,
            "period": self.step.period_s,
            "u_scale": self.step.u_scale,
        }
        for one in self.sensors:
            signals["q"], signals["v"], *after = one.value(signals, self.memory)
            keys = ((one.effect.name, state) for state in one.effect.states)
            self.memory.update(zip(keys, after, strict=True))
        return np.stack([signals["q"], signals["v"]], axis=1)

    def _correct(self, i: int, missed: Array, gain: Array, usable: Array) -> None:
        """Correct by what was missed `(lanes, 2)`; of the log's first sample everything is
        taken."""
        if i == 0:
            self.state = self.state.copy()
            self.state[:, :MOTION] += np.where(usable > 0.0, missed, 0.0)
            return
        by = np.einsum("lkc,lc->lk", gain, missed)
        self.state = self.state.copy()
        self.state[:, :MOTION] += by[:, :MOTION]
        self.push = self.push + by[:, FORCE]
        for one in self.sensors:
            if one.effect.hides_velocity:
                hidden, before = ((one.effect.name, state) for state in one.effect.states)
                self.memory[hidden] = self.memory[hidden] + by[:, HIDDEN]
                self.memory[before] = self.memory[before] + by[:, 1]

    def _advance(self, i: int, many: int) -> None:
        """Step on to the next sample."""
        now, behind = self._steps(i, many)
        for k in range(int((behind - now).max(initial=0))):
            on = np.flatnonzero(now + k < behind)
            lanes: Any = slice(None) if len(on) == many else on
            at = [
                (r.commands[now[j] + k, 0], r.h_s[now[j] + k, 0], r.timeline.begins_s[now[j] + k])
                for j, r in enumerate(self.runs[:many])
                if now[j] + k < behind[j]
            ]
            u, h_s, t_s = np.array(at).T
            step = self.step if len(on) == many else self.step.at(lanes)
            memory = {key: value[lanes] for key, value in self.memory.items()}
            after, memory = step.advance(self.state[lanes], u, h_s, t_s, memory, self.push[lanes])
            if len(on) == many:
                self.state, self.memory = after, memory
                continue
            self.state = self.state.copy()
            self.state[lanes] = after
            for key, value in memory.items():
                self.memory[key] = self.memory[key].copy()
                self.memory[key][lanes] = value

    def _steps(self, i: int, many: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The steps from a sample on, and those behind the next."""
        firsts = [r.timeline.first for r in self.runs[:many]]
        now = np.array([first[i] for first in firsts])
        behind = np.array([first[min(i + 1, len(first) - 1)] for first in firsts])
        return now, behind
