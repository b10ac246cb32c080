"""Rollout fits: parameters of a nominal form and any effects by least squares of the simulation error.

Levenberg-Marquardt on windows of the adaptation episodes. The only noisy input of a rollout is its start, and starts are
estimated too: two unknowns of each joint for each window, eliminated by their Schur complement, so that noise in the observed states
does not bias the parameters. Blocks of lanes give the error and all its derivatives at once.
Source: J. Nocedal, S. Wright, Numerical Optimization (2006), section 10.3; elimination: B. Triggs et al., Bundle Adjustment (1999), 6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.model.block import BLOCK, joint, kind
from trueup.model.compose import cores
from trueup.model.dynamics import CompiledFamily, Form
from trueup.model.effect import Scale, effects
from trueup.model.family import families
from trueup.model.hypothesis import Hypothesis, Scales, switches
from trueup.model.rigid_body import invert
from trueup.model.series import DECLARED, Series, roll, unobserved

Array = NDArray[np.float64]
STEP = 1e-4  # of a parameter's scale: a finite difference
CORNER = 3e-3  # the same where the error has corners
RAN_AWAY = 1e100  # of a sum of squares: no rollout that stays near its log comes there, and its own square is still finite
UNSEEN = 1e-6  # squared standard errors that an effect makes where the log cannot have shown it
NEGLIGIBLE = 0.02  # of a squared standard error: a decrease not worth an iteration
MEMORY_STEP = 1e-3  # of its scale


@dataclass(frozen=True, slots=True)
class Directions:
    """The ways in which the numbers of a nominal form may move, `(directions, numbers)`, and what each is called.

    A family's are its parameters. A tree's are combinations that its data determine: `sized` ones have the size of what they combine,
    so that their steps need not grow with a value.
    """

    names: tuple[str, ...]
    along: Array
    determined: NDArray[np.bool_]  # which numbers the data show one by one, `(numbers,)`
    sized: bool = False

    @staticmethod
    def of_family(names: Sequence[str]) -> Directions:
        """Each parameter by itself."""
        return Directions(tuple(names), np.eye(len(names)), np.ones(len(names), np.bool_))


@dataclass(frozen=True, slots=True)
class Free:
    """The numbers that a hypothesis leaves free, `(free,)` each: rows in the block, -1 for a combination; names (term or "", number);
    finite-difference steps and bounds. `along` `(free, nominal numbers)` are the ways in which combinations move them.
    """

    rows: NDArray[np.int64]
    names: tuple[tuple[str, str], ...]
    step: Array
    low: Array
    high: Array
    along: Array

    def at(self, values: Array) -> Array:
        """Their values, `(free,)`; those of combinations up to a constant."""
        over = np.maximum(np.einsum("fr,fr->f", self.along, self.along), 1e-300)
        return np.asarray(np.where(self.rows >= 0, values[self.rows], self.along @ values[: self.along.shape[1]] / over))

    def moved(self, values: Array, by: Array) -> Array:
        """The block's vector after steps `(free,)`, no further than to a bound."""
        alone = self.rows >= 0
        after = values.copy()
        after[: self.along.shape[1]] += np.where(alone, 0.0, by) @ self.along
        after[self.rows[alone]] = np.clip(values[self.rows[alone]] + by[alone], self.low[alone], self.high[alone])
        return np.asarray(after)

    def nudge(self, values: Array, which: int, by: float) -> None:
        """Move one of them, in place and past its bounds."""
        if self.rows[which] >= 0:
            values[self.rows[which]] += by
        else:
            values[: self.along.shape[1]] += by * self.along[which]

    def none(self) -> Free:
        """Nothing free."""
        return Free(self.rows[:0], (), self.step[:0], self.low[:0], self.high[:0], self.along[:0])


@dataclass(frozen=True, slots=True)
class Start:
    """Where an episode's rollouts start: each window's positions and velocities `(windows, 2 x joints)`, and the hidden states' offsets."""

    windows: Array
    memory: Mapping[tuple[str, str], float]


@dataclass(frozen=True, slots=True)
class RolloutFit:
    """A fitted hypothesis.

    `values` is the block's parameter vector, `free` its free rows, `starts` where rollouts start, by episode digest. `cost` is the sum
    of squared normalised errors over `samples` numbers, `costs` the same of each window; `information` `(free, free)` the reduced
    normal matrix.
    """

    hypothesis: Hypothesis
    values: Array
    free: Free
    starts: Mapping[str, Start]
    cost: float
    costs: Array
    samples: int
    information: Array
    converged: bool

    @property
    def by_episode(self) -> dict[str, float]:
        """Cost of each episode, by digest."""
        ends = np.cumsum([len(s.windows) for s in self.starts.values()])
        parts = np.split(self.costs, ends[:-1])
        return {key: float(part.sum()) for key, part in zip(self.starts, parts, strict=True)}

    @property
    def misfit(self) -> float:
        """Mean squared normalised error: 1 where noise is all that is left."""
        return self.cost / self.samples

    def parameters(self, of: str = "") -> dict[str, float]:
        """Fitted parameters of one term, or of the nominal form."""
        return {name: float(x) for x, (owner, name) in zip(self.free.at(self.values), self.free.names, strict=True) if owner == of}


@dataclass(frozen=True, slots=True)
class Screening:
    """For each start of an effect `(starts,)`: the cost expected once it acts, the factor on it, and that factor's standard error."""

    cost: Array
    factor: Array
    error: Array


@njit(cache=True, nogil=True)
def _gram(out, observed, weight, window_of, inverse, into):  # type: ignore[no-untyped-def]
    """Sum of outer products of (error, derivatives) over each window; `into` is (windows, used, used)."""
    used = into.shape[1]
    row = np.zeros(used)
    for i in range(len(window_of)):
        w = window_of[i]
        if w < 0:
            continue
        for c in range(observed.shape[1]):
            if weight[i, c] == 0.0:
                continue
            base = out[i, c, 0]
            for lane in range(used):
                row[lane] = (out[i, c, lane] - base) * inverse[lane] * weight[i, c]
            row[0] = (observed[i, c] - base) * weight[i, c]
            for a in range(used):
                for b in range(a + 1):
                    into[w, a, b] += row[a] * row[b]
    for w in range(len(into)):
        for a in range(used):
            for b in range(a):
                into[w, b, a] = into[w, a, b]


def warm(family: str = "oscillator") -> int:
    """Compile what fits and diagnoses need into the cache; the number of effects in the kernel."""
    dynamics = CompiledFamily(families()[family])
    one = unobserved(DECLARED, np.arange(4.0), np.zeros((4, 1)), np.ones(1), 1.0)
    names = Directions.of_family(dynamics.parameter_names)
    Fitter(dynamics.form, names, [Scales(1.0, 1.0, 1.0, 1.0)], np.ones(2)).fit([one], Hypothesis(), dynamics.form.block.nulls, iterations=1)
    return len(effects())


class Fitter:
    """Fits hypotheses on one nominal form to a set of series. Holds no state but what it was built with.

    `scales` are the joints' own sizes, `sigma` `(2 x joints,)` what counts as noise of each position and velocity.
    """

    def __init__(self, form: Form, directions: Directions, scales: Sequence[Scales], sigma: Array) -> None:
        self.form = form
        self.block = form.block
        self.joints = form.block.joints
        self.directions = directions
        self.scales = tuple(scales)
        self.sigma = np.where(np.isfinite(sigma), sigma, np.inf)
        self.start_steps = 1e-3 * np.array([s.position for s in scales] + [s.velocity for s in scales])

    def unit(self, of: str, scale: Scale) -> float:
        """The value of one unit of a scale at a term's joint."""
        return self.scales[joint(of)].of(scale)

    def has_room(self, hypothesis: Hypothesis) -> bool:
        """Whether the lanes suffice for every number of a composition."""
        return len(self.free(hypothesis).rows) <= self._room()

    def _room(self) -> int:
        """How many numbers may be free: a family's fit in one block, a tree's take as many as they need."""
        return BLOCK - 1 - 2 * self.joints if self.form.family >= 0 else 1_000

    def _lanes_for(self, numbers: int) -> int:
        """Lanes for the unperturbed rollout, those of so many numbers, and those of the start; whole blocks."""
        return -(-(1 + numbers + 2 * self.joints) // BLOCK) * BLOCK

    def free(self, hypothesis: Hypothesis, fixed: Iterable[tuple[str, str]] = ()) -> Free:
        """What a hypothesis leaves free, the nominal form's numbers first."""
        kept = set(fixed)
        rows: list[int] = []
        names: list[tuple[str, str]] = []
        steps: list[float] = []
        bounds: list[tuple[float, float]] = []
        along: list[Array] = []
        nothing = np.zeros(self.directions.along.shape[1])
        for row, (name, way) in enumerate(zip(self.directions.names, self.directions.along, strict=True)):
            if ("", name) not in kept:
                rows.append(-1 if self.directions.sized else row)
                names.append(("", name))
                steps.append(STEP)
                bounds.append((-np.inf, np.inf))
                along.append(way)
        for term in hypothesis.effects:
            effect = kind(term)
            for row, number in zip(self.block.rows(term), effect.params, strict=True):
                if (term, number.name) in kept:
                    continue
                unit = self.unit(term, number.scale)
                rows.append(row)
                names.append((term, number.name))
                steps.append(unit * (CORNER if number.name in effect.threshold else STEP))
                bounds.append((number.low * unit, number.high * unit))
                along.append(nothing)
        limits, ways = np.array(bounds).reshape(-1, 2), np.array(along).reshape(len(rows), -1)
        return Free(np.array(rows, np.int64), tuple(names), np.array(steps), limits[:, 0], limits[:, 1], ways)

    def begin(self, parameters: Sequence[float]) -> Array:
        """A block's parameter vector in which nothing acts."""
        values = self.block.nulls.copy()
        values[: len(parameters)] = parameters
        return values

    def with_effect(self, values: Array, term: str, start: Sequence[float]) -> Array:
        """The same with one term begun at a start given in units of its scales."""
        values = values.copy()
        for row, number, x in zip(self.block.rows(term), kind(term).params, start, strict=True):
            values[row] = number.null if np.isnan(x) else np.clip(x, number.low, number.high) * self.unit(term, number.scale)
        return values

    def fit(
        self,
        data: Sequence[Series],
        hypothesis: Hypothesis,
        values: Array,
        starts: Mapping[str, Start] | None = None,
        *,
        iterations: int = 12,
        fixed: Iterable[tuple[str, str]] = (),
        only_starts: bool = False,
        hold_starts: bool = False,
        tolerance: float = 1e-4,
    ) -> RolloutFit:
        """Levenberg-Marquardt from `values`. With `only_starts`, what the windows start from is estimated alone; with `hold_starts` their
        positions and velocities stay as observed, as a prediction's do.
        """
        free = self.free(hypothesis, fixed)
        if only_starts:
            free = free.none()
        states = self._memories(hypothesis, len(free.rows))
        values = free.moved(values, np.zeros(len(free.rows)))
        given = starts or {}
        now = {s.digest: given.get(s.digest, Start(s.begin, {})) for s in data}
        best = self._evaluate(data, hypothesis, values, now, free, states, hold_starts)
        damping, converged = 1e-3, False
        for _ in range(iterations if np.isfinite(best.cost) else 0):
            step, moves, expected = best.step(damping, values, free)
            if not expected > tolerance * best.cost + NEGLIGIBLE:
                converged = True
                break
            tried = free.moved(values, step)
            there = {key: _moved(now[key], *move, states) for key, move in moves.items()}
            found = self._evaluate(data, hypothesis, tried, there, free, states, hold_starts)
            if found.cost < best.cost:
                damping = max(damping * (0.2 if best.cost - found.cost > 0.5 * expected else 1.0), 1e-9)
                values, now, best = tried, there, found
            else:
                damping = damping * 10.0
                if damping > 1e7:  # noqa: PLR2004  (nothing within a millionth of a step is better)
                    converged = True
                    break
        n = len(free.rows)
        information = best.reduced()[0] if np.isfinite(best.cost) else np.zeros((n, n))
        samples = sum(int((s.usable & (s.window_of >= 0)[:, None] & np.isfinite(self.sigma)).sum()) for s in data)
        costs = np.concatenate([g[:, 0, 0] for g in best.parts.values()])
        return RolloutFit(hypothesis, values, free, now, best.cost, costs, samples, information, converged)

    def screen(self, data: Sequence[Series], parent: RolloutFit, effect: str) -> Screening:
        """What a linear model expects of each start of an effect on a parent's rollouts.

        What the effect does to them is scaled by one factor, and everything that the parent leaves free adapts to it. One lane for
        each start. Where the parent's own parameters leave no lane, nothing can be said.
        """
        free = self.free(parent.hypothesis)
        starts = kind(effect).starts
        room = self._room() - len(free.rows)
        if room <= 0:
            return Screening(np.full(len(starts), parent.cost), np.zeros(len(starts)), np.full(len(starts), np.inf))
        parts = [self._screened(data, parent, effect, free, starts[i : i + room]) for i in range(0, len(starts), room)]
        cost, factor, error = np.concatenate(parts, axis=1)
        return Screening(cost, factor, error)

    def _screened(self, data: Sequence[Series], parent: RolloutFit, effect: str, free: Free, begins: Sequence[Sequence[float]]) -> Array:
        n, k = len(free.rows), len(begins)
        p, inverse = self._lanes(parent.values, free, n + k)
        off = list(self.block.rows(effect))
        p[off] = self.block.nulls[off, None]
        for lane, begin in enumerate(begins, start=n + 1):
            p[:, lane] = self.with_effect(parent.values, effect, begin)
            inverse[lane] = 1.0
        inverse[n + k + 1 : n + k + 1 + 2 * self.joints] = 1.0 / self.start_steps
        parts = self._grams(data, parent.hypothesis | effect, p, inverse, parent.starts, n + k, {})
        parts = {key: np.where(np.abs(g) < RAN_AWAY, g, 0.0) for key, g in parts.items()}
        normal, gradient = _Gram(parts, {key: np.zeros(0) for key in parts}, np.zeros(0), n + k).reduced(1e-9)
        found = np.array([[parent.cost] * k, [0.0] * k, [np.inf] * k])
        for i in range(k):
            columns = [*range(n), n + i]
            diagonal = np.diag(normal)[columns]
            if not diagonal[-1] > UNSEEN:
                continue
            size = np.sqrt(np.maximum(diagonal, UNSEEN))
            inverse_part = np.linalg.inv(normal[np.ix_(columns, columns)] / size[:, None] / size + 1e-9 * np.eye(n + 1))
            by = inverse_part @ (gradient[columns] / size)
            gained = float(by @ (gradient[columns] / size)) if by[-1] > 0.0 else 0.0
            if kind(effect).zoomed:  # it does not grow in proportion: as it is, or not at all
                rest, pulled = columns[:-1], gradient[columns[:-1]] - normal[columns[:-1], n + i]
                adapted = float(pulled @ np.linalg.lstsq(normal[np.ix_(rest, rest)], pulled, rcond=None)[0])
                gained = 2.0 * gradient[n + i] - normal[n + i, n + i] + adapted
            found[:, i] = parent.cost - gained, by[-1] / size[-1], np.sqrt(inverse_part[-1, -1]) / size[-1]
        return found

    def _memories(self, hypothesis: Hypothesis, free: int) -> tuple[tuple[str, str], ...]:
        """The hidden states whose past is estimated, as far as lanes are left."""
        keys = [key for key in self.block.memories if key[0] in hypothesis.effects]
        return tuple(keys[: max(0, self._room() - free)])

    def _evaluate(
        self, data: Sequence[Series], hypothesis: Hypothesis, values: Array, starts: Mapping[str, Start], free: Free,
        states: tuple[tuple[str, str], ...], hold_starts: bool,
    ) -> _Gram:  # fmt: skip
        n, m = len(free.rows), len(states)
        p, inverse = self._lanes(values, free, n + m)
        scales = np.array([self.unit(t, kind(t).memory[kind(t).states.index(state)]) for t, state in states])
        pasts = {key: (lane, MEMORY_STEP * scale) for lane, (key, scale) in enumerate(zip(states, scales, strict=True), start=n + 1)}
        inverse[n + m + 1 : n + m + 1 + 2 * self.joints] = 0.0 if hold_starts else 1.0 / self.start_steps
        parts = self._grams(data, hypothesis, p, inverse, starts, n + m, pasts)
        began = {s.digest: np.array([starts[s.digest].memory.get(key, 0.0) for key in states]) for s in data}
        return _Gram(parts, began, scales, n)

    def _lanes(self, values: Array, free: Free, numbers: int) -> tuple[Array, Array]:
        """Lanes with one for each free number, and the inverse of each lane's step."""
        lanes = self._lanes_for(numbers)
        p = np.repeat(values[:, None], lanes, axis=1)
        inverse = np.zeros(lanes)
        for lane, row in enumerate(free.rows, start=1):
            size = free.step[lane - 1]
            if 0 <= row < self.block.nominal:
                size *= max(1.0, abs(values[row]))
            elif row >= 0:
                size = -size if values[row] + size > free.high[lane - 1] else size
            free.nudge(p[:, lane], lane - 1, size)
            inverse[lane] = 1.0 / size
        return p, inverse

    def _grams(
        self, data: Sequence[Series], hypothesis: Hypothesis, p: Array, inverse: Array, starts: Mapping[str, Start], before: int,
        pasts: Mapping[tuple[str, str], tuple[int, float]],
    ) -> dict[str, Array]:  # fmt: skip
        """Outer products by episode; the lanes behind `before` ones hold the derivatives by the start.

        `pasts` are the lanes and steps of hidden states' derivatives: inwards, for beyond its end a play has none.
        """
        on, inverse = switches(hypothesis, self.joints), inverse.copy()
        parts = {}
        for s in data:
            start = starts[s.digest]
            block = p.copy()
            for key, value in start.memory.items():
                block[self.block.memories[key]] += value
            for key, (lane, size) in pasts.items():
                inwards = -size if start.memory.get(key, 0.0) > 0.0 else size
                block[self.block.memories[key], lane] += inwards
                inverse[lane] = 1.0 / inwards
            init = np.repeat(start.windows[:, :, None], block.shape[1], axis=2)
            for state, size in enumerate(self.start_steps):
                init[:, state, before + 1 + state] += size
            out = roll(s, self.form, block, on, init)
            used = before + 1 + len(self.start_steps)
            parts[s.digest] = np.zeros((len(init), used, used))
            _gram(out, s.observed, s.usable / self.sigma, s.window_of, inverse, parts[s.digest])
        return parts


def _moved(start: Start, windows: Array, memory: Array, states: tuple[tuple[str, str], ...]) -> Start:
    kept = dict(start.memory)
    for key, by in zip(states, memory, strict=True):
        kept[key] = kept.get(key, 0.0) + float(by)
    return Start(start.windows + windows, kept)


@dataclass(frozen=True, slots=True)
class _Gram:
    """Outer products of (error, parameter, memory and start derivatives), by episode, `(windows, used, used)`.

    Starts are eliminated window by window, then what hidden states began with episode by episode; those have a prior of one scale.
    """

    parts: Mapping[str, Array]
    began: Mapping[str, Array]
    scales: Array
    free: int

    @property
    def cost(self) -> float:
        if not all(np.abs(g).max(initial=0.0) < RAN_AWAY for g in self.parts.values()):
            return np.inf  # it ran away, or would a little further on
        prior = sum(float(np.sum((b / self.scales) ** 2)) for b in self.began.values())
        return sum(float(g[:, 0, 0].sum()) for g in self.parts.values()) + prior

    def _condensed(self, damping: float) -> _Condensed:
        """Starts eliminated window by window: matrices over (error, parameters, memories) by episode, with the memories' prior."""
        n, m = self.free, len(self.scales)
        sizes = [len(g) for g in self.parts.values()]
        stacked = np.concatenate(list(self.parts.values()))
        episode = np.repeat(np.arange(len(sizes)), sizes)
        own = stacked.shape[1] - (n + m + 1)
        inverse, cross = np.empty((len(stacked), own, own)), np.empty((len(stacked), own, n + m + 1))
        total = np.zeros((len(sizes), n + m + 1, n + m + 1))
        _eliminate(stacked, episode, n + m + 1, damping, inverse, cross, total)
        if m:
            weight = self.scales**-2
            at = np.arange(n + 1, n + m + 1)
            felt = total[:, at, at] > weight  # a past that the episode does not show, as beyond a play's end, stays where it is
            total[:, at, at] = (total[:, at, at] + weight) * (1.0 + damping)
            pull = np.where(felt, weight * np.array(list(self.began.values())), 0.0)
            total[:, 0, at] -= pull
            total[:, at, 0] -= pull
        solve = np.linalg.inv(total[:, n + 1 :, n + 1 :])
        reduced = (total[:, : n + 1, : n + 1] - total[:, : n + 1, n + 1 :] @ solve @ total[:, n + 1 :, : n + 1]).sum(axis=0)
        return _Condensed(episode, inverse, cross, total, np.asarray(solve, float), reduced)

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Normal matrix and gradient of the parameters once starts and memories are eliminated."""
        total = self._condensed(damping).reduced
        return total[1:, 1:], total[0, 1:]

    def step(self, damping: float, values: Array, free: Free) -> tuple[Array, dict[str, tuple[Array, Array]], float]:
        """Steps of the parameters and of each episode's starts and memories, and the decrease that the linear model expects."""
        c, n = self._condensed(damping), self.free
        normal, gradient = c.reduced[1:, 1:], c.reduced[0, 1:]
        at = free.at(values)
        moving = ~(((at <= free.low) & (gradient < 0.0)) | ((at >= free.high) & (gradient > 0.0)))
        step = np.zeros(n)
        if moving.any():
            part = normal[np.ix_(moving, moving)]
            size = np.sqrt(np.maximum(np.diag(part), 1e-300))
            scaled = part / size[:, None] / size + (damping + 1e-12) * np.eye(len(size))
            step[moving] = np.linalg.solve(scaled, gradient[moving] / size) / size
        memory = np.einsum("eij,ej->ei", c.solve, c.total[:, n + 1 :, 0] - c.total[:, n + 1 :, 1 : n + 1] @ step)
        others = np.concatenate([np.repeat(step[None], len(memory), axis=0), memory], axis=1)[c.episode]
        windows = np.einsum("wij,wj->wi", c.inverse, c.cross[:, :, 0] - np.einsum("wij,wj->wi", c.cross[:, :, 1:], others))
        expected = float(step @ gradient)
        expected += float(np.einsum("ei,eij,ej->", c.total[:, n + 1 :, 0], c.solve, c.total[:, n + 1 :, 0]))
        expected += float(np.einsum("wi,wij,wj->", c.cross[:, :, 0], c.inverse, c.cross[:, :, 0]))
        moves = {key: (windows[c.episode == e], memory[e]) for e, key in enumerate(self.parts)}
        return step, moves, expected


@dataclass(frozen=True, slots=True)
class _Condensed:
    """Products of an elimination: `inverse` and `cross` of starts by window, `total` and `solve` of memories by episode."""

    episode: NDArray[np.int64]
    inverse: Array
    cross: Array
    total: Array
    solve: Array
    reduced: Array


@njit(cache=True, nogil=True, error_model="numpy")
def _eliminate(g, episode, size, damping, inverse, cross, total):  # type: ignore[no-untyped-def]
    """The Schur complement of each window's starting values, summed by episode."""
    own = g.shape[1] - size
    part, solved = np.empty((own, own)), np.empty((own, size))
    for w in range(len(g)):
        ridge = 0.0
        for i in range(own):
            for k in range(own):
                part[i, k] = g[w, size + i, size + k]
            part[i, i] *= 1.0 + damping
            ridge += part[i, i]
        for i in range(own):
            part[i, i] += 1e-9 * max(ridge, 1e-3)
        invert(part, inverse[w])
        for i in range(own):
            for k in range(size):
                cross[w, i, k] = g[w, size + i, k]
        for i in range(own):
            for k in range(size):
                solved[i, k] = 0.0
                for l in range(own):  # noqa: E741
                    solved[i, k] += inverse[w, i, l] * cross[w, l, k]
        e = episode[w]
        for i in range(size):
            for k in range(size):
                total[e, i, k] += g[w, i, k]
                for l in range(own):  # noqa: E741
                    total[e, i, k] -= cross[w, l, i] * solved[l, k]


def in_parallel(work: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
    """Map over threads, in order: the kernel holds no lock."""
    with ThreadPoolExecutor(cores()) as pool:
        yield from pool.map(work, items)
