"""Rollouts of a hypothesis over windows, with their derivatives: the normal equations at a place.

Blocks of lanes give the error and all its derivatives at once, one lane for each number that moves.
The only noisy input of a rollout is its start, and starts are estimated too (multiple shooting):
two unknowns of each joint for each window, eliminated by their Schur complement, so that noise in
the observed states does not bias the parameters. Source: H. G. Bock, Recent Advances in Parameter
Identification Techniques for O.D.E. (1983), on multiple shooting; elimination: B. Triggs et al.,
Bundle Adjustment (1999), 6.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trueup.fit.errors import Errors, KeptDerivatives
from trueup.fit.free_numbers import CORNER_STEP, STEP, Directions, Free
from trueup.fit.held_starts import held_starts
from trueup.fit.lanes import LaidOut, Lanes, Task
from trueup.fit.normal_equations import NormalEquations
from trueup.fit.rollout_fit import Start
from trueup.fit.window_sums import WindowSums
from trueup.model.block import BLOCK, joint, kind
from trueup.model.dynamics import Form
from trueup.model.effect import Port, Scale
from trueup.model.hypothesis import Hypothesis, Scales, begun, switches
from trueup.model.roll import roll_parts
from trueup.model.series import Series
from trueup.model.stack import Part, Stack

Array = NDArray[np.float64]
MEMORY_STEP = 1e-3  # of its scale: the finite difference of a hidden state's past
START_STEP = 1e-3  # of a scale: the finite difference of where a window starts


@dataclass(frozen=True, slots=True)
class CentralDifferences:
    """The normal equations at a place by differences on both sides of each free number.

    `task` says what is fitted. `gradient` `(free,)` is minus half that of the cost with windows'
    starts fixed, `curvature` half the cost's second difference, nan at a bound, and `diagonal` the
    normal equations' own before starts are eliminated.
    """

    equations: NormalEquations
    task: Task
    gradient: Array
    curvature: Array
    diagonal: Array

    def moved(self, starts: Mapping[str, Start], step: Array) -> dict[str, Start]:
        """Where windows start after what is best for them beside a step of the free numbers."""
        return self.task.moved(starts, self.equations.moves_with(step))


class Rollouts:
    """What rollouts of one nominal form are compared with, and how they are differentiated. Holds
    no state but what it was built with.

    `scales` are the joints' own sizes, `sigma` `(2 x joints,)` what counts as noise of each
    position and velocity, `correlation` that of the noise with itself one sample before, 0 where
    not given. Where starts are `held`, windows start as observed, as a prediction's do: what no law
    explains must not hide in their starts.
    """

    def __init__(
        self,
        form: Form,
        directions: Directions,
        scales: Sequence[Scales],
        sigma: Array,
        correlation: Array | None = None,
        *,
        held: bool = False,
    ) -> None:
        self.form = form
        self.block = form.block
        self.of_tree = form.of_tree
        self.of_robot = form.of_robot
        self.joints = form.block.joints
        self.directions = directions
        self.scales = tuple(scales)
        self.sigma = np.where(np.isfinite(sigma), sigma, np.inf)
        self.held = held
        self.correlation = np.zeros(len(sigma)) if correlation is None else correlation
        self.start_steps = START_STEP * np.array(
            [s.position for s in scales] + [s.velocity for s in scales]
        )

    def holding(self) -> Self:
        """A copy whose windows start as observed."""
        held = copy(self)
        held.held = True
        return held

    def freed(self) -> Self:
        """A copy whose windows start where they fit best."""
        free = copy(self)
        free.held = False
        return free

    def unit(self, of: str, scale: Scale) -> float:
        """The value of one unit of a scale at a term's joint."""
        return self.scales[joint(of)].of(scale)

    def has_room(self, hypothesis: Hypothesis) -> bool:
        """Whether the lanes suffice for every number of a composition."""
        return len(self.free(hypothesis).rows) <= self.room()

    def room(self) -> int:
        """How many numbers may be free: a family's fit in one block, a robot's take as many as they
        need."""
        return BLOCK - 1 - 2 * self.joints if not self.of_robot else 1_000

    def free(self, hypothesis: Hypothesis, fixed: Iterable[tuple[str, str]] = ()) -> Free:
        """What a hypothesis leaves free, the nominal form's numbers first."""
        fixed, rows = set(fixed), list[tuple[int, str, str, float, float, float, Array]]()
        ways, nothing = self.directions, np.zeros(self.directions.along.shape[1])
        for name, row, way, size, low in zip(
            ways.names, ways.alone, ways.along, ways.steps, ways.low, strict=True
        ):
            rows.append((int(row), "", name, float(size), float(low), np.inf, way))
        for term in hypothesis.effects:
            effect = kind(term)
            for row, number in zip(self.block.rows(term), effect.params, strict=True):
                unit = self.unit(term, number.scale)
                size = unit * (CORNER_STEP if number.name in effect.threshold else STEP)
                low, high = number.low * unit, number.high * unit
                rows.append((row, term, number.name, size, low, high, nothing))
        rows = [row for row in rows if row[1:3] not in fixed]
        steps, lows, highs = np.array([row[3:6] for row in rows]).reshape(-1, 3).T
        return Free(
            np.array([row[0] for row in rows], np.int64),
            tuple((row[1], row[2]) for row in rows),
            steps.copy(),
            lows.copy(),
            highs.copy(),
            np.array([row[6] for row in rows]).reshape(len(rows), -1),
        )

    def initial_values(self, parameters: Sequence[float]) -> Array:
        """The block's parameter vector with these parameters of the nominal form, in which nothing
        acts."""
        values = self.block.nulls.copy()
        values[: len(parameters)] = parameters
        return values

    def with_effect(self, values: Array, term: str, guess: Sequence[float]) -> Array:
        """The block's vector with one term set to an initial guess in units of its scales."""
        return begun(self.block, values, self.scales[joint(term)], term, guess)

    def expected(self, free: Free) -> tuple[Array, Array]:
        """Where a robot's numbers are expected, and the inverse squares of how far from there, 0
        where nothing is known, `(free,)` each."""
        own = np.array([owner == "" for owner, _ in free.names], np.bool_) & self.of_tree
        nominal = np.zeros(len(self.block.nulls))
        nominal[: len(self.directions.nominal)] = self.directions.nominal
        return np.where(own, (STEP / free.step) ** 2, 0.0), np.where(own, free.at(nominal), 0.0)

    def initial_starts(
        self, starts: Mapping[str, Start] | None, data: Sequence[Series], hypothesis: Hypothesis
    ) -> dict[str, Start]:
        """Where rollouts start: as given, or as observed; where they are held, as observed whatever
        was given.
        """
        given = {s.digest: (starts or {}).get(s.digest, Start(s.begin, {})) for s in data}
        if not self.held:
            return given
        hidden = [joint(t) for t in hypothesis.effects if kind(t).hides_velocity]
        seen = np.isfinite(self.sigma)
        observed = {s.digest: held_starts(s, self.sigma, hidden) for s in data}
        return {
            key: replace(start, windows=np.where(seen, observed[key], start.windows))
            for key, start in given.items()
        }

    def repeated(self, values: Array, start: Start) -> Array:
        """A block of lanes `(rows, BLOCK)` that all hold the same numbers and what hidden states
        began with."""
        p = np.repeat(values[:, None], BLOCK, axis=1)
        for key, value in start.memory.items():
            p[self.block.memories[key]] += value
        return p

    def forgets(self, hypothesis: Hypothesis) -> bool:
        """Whether a window's rollout depends on its own start alone."""
        kinds = [kind(t) for t in hypothesis.effects]
        return not any(k.states or (k.delays() and k.port is Port.OBSERVATION) for k in kinds)

    def samples(self, data: Sequence[Series]) -> int:
        """Numbers that are compared."""
        return int(Stack.of(data).usable_in_windows[np.isfinite(self.sigma)].sum())

    def task(self, data: Sequence[Series], hypothesis: Hypothesis, free: Free) -> Task:
        """What is fitted: some series by a hypothesis, with the numbers that are free."""
        keys = [key for key in self.block.memories if key[0] in hypothesis.effects]
        states = tuple(keys[: max(0, self.room() - len(free.rows))])  # as far as lanes are left
        directions = sum(owner == "" for owner, _ in free.names)
        several = 1 + len(free.rows) + len(states) + 2 * self.joints > BLOCK
        return Task(Stack.of(data), hypothesis, free, states, directions if several else 0)

    def evaluate(
        self,
        task: Task,
        values: Array,
        starts: Mapping[str, Start],
        old: KeptDerivatives | None = None,
    ) -> tuple[NormalEquations, KeptDerivatives | None]:
        """The normal equations at a place, and the derivatives that may be kept of them; given
        `old` derivatives, those are used."""
        lanes = self.lanes(task, values, task.keeps if old else 0, len(task.states))
        return self._equations(task, lanes, starts, old)[:2]

    def _equations(
        self,
        task: Task,
        lanes: Lanes,
        starts: Mapping[str, Start],
        old: KeptDerivatives | None = None,
    ) -> tuple[NormalEquations, KeptDerivatives | None, Array]:
        """The normal equations of lanes laid out, the derivatives that may be kept, and what each
        lane costs by itself where differences are central, `(lanes,)`."""
        scales = np.array(
            [self.unit(t, kind(t).memory[kind(t).states.index(state)]) for t, state in task.states]
        )
        at = lanes.of[len(lanes.of) - len(task.states) :]
        pasts = {
            key: (lane, MEMORY_STEP * scale)
            for lane, key, scale in zip(at, task.states, scales, strict=True)
        }
        sums, kept, costs = self.sums(task, lanes, starts, pasts, old)
        began = np.array(
            [
                [starts[digest].memory.get(key, 0.0) for key in task.states]
                for digest in task.stack.digests
            ]
        ).reshape(len(task.stack.digests), len(task.states))
        free = len(task.free.rows)
        return NormalEquations(sums, task.stack.window_ends, began, scales, free), kept, costs

    def around(
        self,
        data: Sequence[Series],
        hypothesis: Hypothesis,
        values: Array,
        starts: Mapping[str, Start],
        free: Free,
    ) -> CentralDifferences:
        """The normal equations at a place by differences on both sides, with the gradient of the
        cost itself.

        That gradient compares the costs on either side of each number: it does not see kinks that
        are finer than the numbers' steps.
        """
        task = replace(self.task(data, hypothesis, replace(free, central=True)), keeps=0)
        lanes = self.lanes(task, values, 0, len(task.states))
        equations, _, costs = self._equations(task, lanes, starts)
        n = len(free.rows)
        if not np.isfinite(equations.cost):
            return CentralDifferences(equations, task, np.zeros(n), np.zeros(n), np.zeros(n))
        total = equations.sums[:, : n + 1, : n + 1].sum(axis=0)
        up, down, per, sides = (
            costs[lanes.of[:n]],
            costs[lanes.against[:n]],
            lanes.inverse[lanes.of[:n]],
            lanes.against[:n] > 0,
        )
        return CentralDifferences(
            equations,
            task,
            np.where(sides, 0.5 * (down - up) * per, total[0, 1:]),
            np.where(sides, 2.0 * (up + down - 2.0 * total[0, 0]) * per**2, np.nan),
            np.diag(total)[1:],
        )

    def lanes(self, task: Task, values: Array, kept: int, more: int) -> Lanes:
        """One lane for each free number but the first `kept`, and `more` lanes; where none are
        kept, lanes of the start before them.

        Parameters of a lane differ from lane 0's by the step of its number.
        """
        free, moving = task.free, np.arange(kept, len(task.free.rows))
        starts = 0 if kept else 2 * self.joints
        of = 1 + starts + np.arange(len(moving) + more)
        behind = 1 + starts + len(of)
        count = -(-(behind + len(moving) * free.central) // BLOCK) * BLOCK
        p = np.repeat(values[:, None], count, axis=1)
        inverse, against = np.zeros(count), np.zeros(len(of) + starts, np.int64)
        steps = self._steps(free, values)[moving]
        own = of[: len(moving)]
        free.nudge(p, own, moving, steps)
        inverse[own] = 1.0 / steps
        if free.central:
            behind_them = values[free.rows[moving]] - steps
            inside = (free.low[moving] <= behind_them) & (behind_them <= free.high[moving])
            both = inside | (free.rows[moving] < 0)
            other = behind + np.flatnonzero(both)
            free.nudge(p, other, moving[both], -steps[both])
            inverse[own[both]], against[np.flatnonzero(both)] = 0.5 / steps[both], other
        fixed = np.isfinite(self.sigma[:starts]) & self.held
        inverse[1 : 1 + starts] = np.where(fixed, 0.0, 1.0 / self.start_steps[:starts])
        return Lanes(p, inverse, of, starts, against)

    def _steps(self, free: Free, values: Array) -> Array:
        """The steps of differences by free numbers `(free,)`: a parameter's no shorter than what
        rounding leaves of it, any other's back where it would leave its bounds."""
        at, alone = values[free.rows], free.rows >= 0
        of_family = alone & (free.rows < self.block.nominal) & (not self.of_tree)
        longest = free.step if free.central else np.maximum(free.step, STEP * np.abs(at))
        back = alone & ~of_family & (at + free.step > free.high)
        return np.where(of_family, longest, np.where(back, -free.step, free.step))

    def sums(
        self,
        task: Task,
        lanes: Lanes,
        starts: Mapping[str, Start],
        pasts: Mapping[tuple[str, str], tuple[int, float]],
        old: KeptDerivatives | None,
    ) -> tuple[Array, KeptDerivatives | None, Array]:
        """Sums of outer products by window, the derivatives that may be kept, and what each lane
        costs.

        `pasts` are the lanes and steps of hidden states' derivatives: inwards, for beyond its end a
        play has none.
        """
        stack, usual, several = task.stack, self.start_steps, lanes.p.shape[1] > BLOCK
        at = LaidOut.of(lanes, stack, starts, pasts, self.block, usual, task.keeps)
        sums = WindowSums(
            self.errors(stack, task.hypothesis, lanes.p[:, 0]), lanes, at, task.keeps, old
        )
        costs = np.zeros((len(at.init), lanes.p.shape[1] if task.free.central else 0))

        def add(part: Part, out: Array) -> None:
            sums.add(part, out)
            if task.free.central:
                sums.errors.add_costs(part, out, costs)

        roll_parts(
            self.form,
            switches(task.hypothesis, self.joints),
            at.rollout(stack, usual, lanes.starts if old is None else 0),
            add,
            in_threads=(several or self.of_tree) and len(stack) > 1,
        )
        return *sums.done(usual), costs.sum(axis=0)

    def errors(self, stack: Stack, hypothesis: Hypothesis, values: Array) -> Errors:
        """What a rollout of a stack is compared with."""
        window_of, counts = stack.seen(self._late_s(hypothesis, values))
        return Errors(
            stack.observed,
            counts,
            self.sigma,
            window_of,
            stack.t_s,
            stack.periods_of_windows,
            self.correlation,
            stack.episode_of,
        )

    def _late_s(self, hypothesis: Hypothesis, values: Array) -> Array:
        """How late each joint is seen [s], `(joints,)`; a log of one joint does not show that apart
        from a late drive, and is shifted."""
        late_s = np.zeros(self.joints)
        for t in hypothesis.effects:
            if self.of_robot and kind(t).port is Port.OBSERVATION and kind(t).delays():
                late_s[joint(t)] += values[self.block.rows(t)[0]]
        return late_s
