"""The filter of a simulator's rollout: the model, corrected by each observation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.simulator.run import Run
from trueup.model.simulator.sensors import Followed, seen_late
from trueup.model.simulator.step import Memory, SimulatedStep
from trueup.model.simulator.timeline import Acting

Array = NDArray[np.float64]
# rows of a gain: what corrects a velocity, a disturbing acceleration, and what hides the velocity
VELOCITY, FORCE, HIDDEN = 1, 2, 3
FIRST = slice(1)  # of a run's lanes: the filter's


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
        commands = np.array([r.series.issued[0] for r in runs])
        for one in self.sensors:
            self.memory |= one.begin(commands[:, one.joint], len(runs))
        self.joints, self.motion = self.step.simulator.joints, self.step.simulator.motion
        self.push = np.zeros((len(runs), self.joints))
        self.late_s = np.stack([r.late_s[:, 0] for r in runs])
        self.passed = np.zeros((int(self.samples[0]), len(runs), self.motion))
        self._lay_out_steps()

    def _lay_out_steps(self) -> None:
        """The steps of all episodes side by side: the first from each sample on, `(samples + 1,
        runs)`, and commands, lengths [s] and times [s] of each, `(steps, runs, …)`."""
        shape = int(self.samples[0]) + 1, len(self.runs)
        most = max(len(r.h_s) for r in self.runs)
        self.first = np.zeros(shape, np.int64)
        self.u = np.zeros((most, len(self.runs), self.joints))
        self.h_s, self.begins_s = (np.zeros((most, len(self.runs))) for _ in range(2))
        for r, run in enumerate(self.runs):
            steps, first = len(run.h_s), run.timeline.first
            self.first[: len(first), r], self.first[len(first) :, r] = first, first[-1]
            self.u[:steps, r] = run.commands[:, :, 0]
            self.h_s[:steps, r] = run.h_s[:, 0]
            self.begins_s[:steps, r] = run.timeline.begins_s
        self.most_steps = np.diff(self.first, axis=0).max(axis=1).tolist()

    def run(self) -> list[Followed]:
        """Follow all episodes to their ends."""
        total = int(self.samples[0])
        states = np.zeros((total, *self.state.shape))
        seen = np.zeros((total, len(self.runs), self.motion))
        kept = {key: np.zeros((total, len(self.runs))) for key in self.memory}
        times = np.zeros((total, len(self.runs)))
        observed, usable = (np.zeros((total, len(self.runs), self.motion)) for _ in range(2))
        gains = np.zeros((total, len(self.runs), self.joints, 4, 2))
        for r, run in enumerate(self.runs):
            n, gain = self.samples[r], run.gain
            assert gain is not None
            times[:n, r], observed[:n, r] = run.series.t_s, run.series.observed
            usable[:n, r] = run.series.usable
            gains[:n, r] = gain[np.minimum(np.arange(n), len(gain) - 1)]
        by_joint = usable.reshape(total, len(self.runs), 2, self.joints)
        gains *= by_joint.swapaxes(2, 3)[:, :, :, None, :]
        for i in range(total):
            many = int(np.searchsorted(-self.samples, -i, side="left"))
            if many < len(self.push):
                self._only(slice(many))
            self.passed[i, :many] = self.state[:, : self.motion]
            shown = self._observed(
                i, times[i, :many], times[i, :many] - times[max(i - 1, 0), :many]
            )
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
                self.passed[:n, r],
                seen[:n, r],
            )
            for r, n in enumerate(self.samples)
        ]

    def _only(self, lanes: slice) -> None:
        self.state, self.push = self.state[lanes], self.push[lanes]
        self.memory = {key: value[lanes] for key, value in self.memory.items()}
        self.step = self.step.at(lanes)
        self.sensors = [one.at(lanes) for one in self.sensors]

    def _observed(self, i: int, t_s: Array, since: Array) -> Array:
        """What the sensors show now, `(lanes, 2 x joints)`."""
        seen = self.state[:, : self.motion].copy()
        for r, j in zip(*np.nonzero(self.late_s[: len(seen)] > 0.0), strict=True):
            at, track = np.array([i]), self.passed[:, r, [j, self.joints + j]]
            late_s = self.late_s[r, j]
            when = self.runs[r].series.t_s
            seen[r, [j, self.joints + j]] = seen_late(when, at, late_s, lambda k: track[k].T)[:, 0]  # noqa: B023  (called at once)
        for one in self.sensors:
            signals: dict[str, Any] = {
                "q": seen[:, one.joint].copy(),
                "v": seen[:, self.joints + one.joint].copy(),
                "t": t_s,
                "since": since,
                "period": self.step.period_s,
                "u_scale": float(self.step.u_scale[one.joint]),
            }
            q, v, *after = one.value(signals, self.memory)
            seen[:, one.joint], seen[:, self.joints + one.joint] = q, v
            self.memory.update(zip(one.keys, after, strict=True))
        return seen

    def _correct(self, i: int, missed: Array, gain: Array, usable: Array) -> None:
        """Correct by what was missed `(lanes, 2 x joints)`; of the log's first sample everything is
        taken."""
        self.state = self.state.copy()
        if i == 0:
            self.state[:, : self.motion] += np.where(usable > 0.0, missed, 0.0)
            return
        by = np.einsum("ljkc,lcj->lkj", gain, missed.reshape(len(missed), 2, self.joints))
        self.state[:, : self.motion] += by[:, : VELOCITY + 1].reshape(missed.shape)
        self.push = self.push + by[:, FORCE]
        for one in self.sensors:
            if one.effect.hides_velocity:
                hidden, before = one.keys
                self.memory[hidden] = self.memory[hidden] + by[:, HIDDEN, one.joint]
                self.memory[before] = self.memory[before] + by[:, VELOCITY, one.joint]

    def _advance(self, i: int, many: int) -> None:
        """Step on to the next sample."""
        for k in range(self.most_steps[i]):
            step_of = self.first[i, :many] + k
            on = np.flatnonzero(step_of < self.first[i + 1, :many])
            lanes: Any = slice(None) if len(on) == many else on
            u, h_s, t_s = (x[step_of[on], on] for x in (self.u, self.h_s, self.begins_s))
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
