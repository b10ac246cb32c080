"""Rollout fits: parameters of a nominal form and any effects by least squares of the simulation
error.

Levenberg-Marquardt on windows of the adaptation episodes. The only noisy input of a rollout is its
start, and starts are estimated too: two unknowns of each joint for each window, eliminated by their
Schur complement, so that noise in the observed states does not bias the parameters. Blocks of lanes
give the error and all its derivatives at once. Source: J. Nocedal, S. Wright, Numerical
Optimization (2006), section 10.3; elimination: B. Triggs et al., Bundle Adjustment (1999), 6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.cores import cores
from trueup.fit.normal_equations import NOTHING, RAN_AWAY, Errors, Gram, Kept
from trueup.model.block import BLOCK, joint, kind
from trueup.model.dynamics import CompiledFamily, Form
from trueup.model.effect import Port, Scale, effects
from trueup.model.family import families
from trueup.model.hypothesis import Hypothesis, Scales, begun, switches
from trueup.model.rounding import rounded
from trueup.model.series import DECLARED, Series, roll, seen_by, unobserved

Array = NDArray[np.float64]
STEP = 1e-4  # of a parameter's scale: a finite difference
CORNER = 3e-3  # the same where the error has corners
UNSEEN = 1e-6  # squared standard errors that an effect makes where the log cannot have shown it
ROUGH = 5e-3  # a tolerance beyond which old derivatives do to the end
KEEPS_ITS_WORD = 0.5  # of the expected decrease: a step that brings less wants new derivatives
STARTED = 1e-4  # of the cost: a decrease by starts alone that ends their search
KEPT_IT = 0.9  # of it: a longer one would have
ASTRAY = 100.0  # times the cost: a step that leads there was far too long
# times what is left of a sample: the cost of a robot's number that is off by its size, for
# neighbours err alike
PRIOR = 50.0
NEGLIGIBLE = 0.02  # of a squared standard error: a decrease not worth an iteration
MEMORY_STEP = 1e-3  # of its scale
SCATTERED, UNSEEN_SCATTERED = (
    3.0,
    0.3,
)  # standard deviations of noise, of a scale: how far other starts are looked for
CLOSER = 0.4  # times, from one of those to the next
PROVEN = 0.01  # of a half-width: no estimate would move further
TWO_SIDED = 1.96  # standard errors of a 95 % interval
SWING = 0.5  # of a half-width with all else at rest, to either side: what the data can tell
START_STEP = 1e-3  # of a scale: where a window starts
FINEST = 1e-3  # of that, where what a start does grows a thousandfold before its window ends

Linear = Mapping[str, Kept]  # derivatives that are kept, by episode digest


@dataclass(frozen=True, slots=True)
class Directions:
    """The ways in which the numbers of a nominal form may move, `(directions, numbers)`, and what
    each is called.

    A family's are its parameters. A tree's are `combined`: combinations that its data determine,
    and numbers by themselves. `alone` `(directions,)` is the number that moves by itself, -1 for a
    combination, `low` the least that it may be, `steps` are for finite differences, `nominal`
    `(numbers,)` what numbers are expected near, each within its size.
    """

    names: tuple[str, ...]
    along: Array
    determined: NDArray[np.bool_]  # which numbers the data show one by one, `(numbers,)`
    alone: NDArray[np.int64]
    steps: Array
    low: Array
    nominal: Array
    combined: bool = False

    @staticmethod
    def of_family(names: Sequence[str]) -> Directions:
        """Each parameter by itself."""
        count = len(names)
        return Directions(
            tuple(names),
            np.eye(count),
            np.ones(count, np.bool_),
            np.arange(count),
            np.full(count, STEP),
            np.full(count, -np.inf),
            np.zeros(count),
        )


@dataclass(frozen=True, slots=True)
class Free:
    """The numbers that a hypothesis leaves free, `(free,)` each: rows in the block, -1 for a
    combination; names (term or "", number); finite-difference steps and bounds. `along` `(free,
    nominal numbers)` are the ways in which combinations move them.
    """

    rows: NDArray[np.int64]
    names: tuple[tuple[str, str], ...]
    step: Array
    low: Array
    high: Array
    along: Array
    central: bool = False  # whether differences are taken on both sides

    def at(self, values: Array) -> Array:
        """Their values, `(free,)`; those of combinations up to a constant."""
        over = np.maximum(np.einsum("fr,fr->f", self.along, self.along), 1e-300)
        return np.asarray(
            np.where(
                self.rows >= 0, values[self.rows], self.along @ values[: self.along.shape[1]] / over
            )
        )

    def moved(self, values: Array, by: Array) -> Array:
        """The block's vector after steps `(free,)`, no further than to a bound."""
        alone = self.rows >= 0
        after = values.copy()
        after[: self.along.shape[1]] += np.where(alone, 0.0, by) @ self.along
        after[self.rows[alone]] = np.clip(
            values[self.rows[alone]] + by[alone], self.low[alone], self.high[alone]
        )
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
    """Where an episode's rollouts start: each window's positions and velocities `(windows, 2 x
    joints)`, and the hidden states' offsets.

    `steps` `(windows, 2 x joints)` are for differences by the former, the fitter's own where None.
    """

    windows: Array
    memory: Mapping[tuple[str, str], float]
    steps: Array | None = None


@dataclass(frozen=True, slots=True)
class RolloutFit:
    """A fitted hypothesis.

    `values` is the block's parameter vector, `free` its free rows, `starts` where rollouts start,
    by episode digest. `cost` is the sum of squared normalised errors over `samples` numbers,
    `costs` the same of each window; `information` `(free, free)` the reduced normal matrix and
    `scores` `(windows, free)` what each window adds to the gradient. `off` is how far the minimum
    is, in half-widths of an interval, where that was looked into.
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
    scores: Array
    off: float | None = None

    @property
    def proven(self) -> bool:
        """Whether it was shown to be at a minimum."""
        return self.off is not None and self.off <= PROVEN

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
        return {
            name: float(x)
            for x, (owner, name) in zip(self.free.at(self.values), self.free.names, strict=True)
            if owner == of
        }


@dataclass(frozen=True, slots=True)
class Screening:
    """For each start of an effect `(starts,)`: the cost expected once it acts, the factor on it,
    and that factor's standard error."""

    cost: Array
    factor: Array
    error: Array


def warm(family: str = "oscillator") -> int:
    """Compile what fits and diagnoses need into the cache; the number of effects in the kernel."""
    dynamics = CompiledFamily(families()[family])
    one = unobserved(DECLARED, np.arange(4.0), np.zeros((4, 1)), np.ones(1), 1.0)
    names = Directions.of_family(dynamics.parameter_names)
    Fitter(dynamics.form, names, [Scales(1.0, 1.0, 1.0, 1.0)], np.ones(2)).fit(
        [one], Hypothesis(), dynamics.form.block.nulls, iterations=1
    )
    return len(effects())


class Fitter:
    """Fits hypotheses on one nominal form to a set of series. Holds no state but what it was built
    with.

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
        self.joints = form.block.joints
        self.directions = directions
        self.scales = tuple(scales)
        self.sigma = np.where(np.isfinite(sigma), sigma, np.inf)
        self.held = held
        self.correlation = np.zeros(len(sigma)) if correlation is None else correlation
        self.start_steps = START_STEP * np.array(
            [s.position for s in scales] + [s.velocity for s in scales]
        )

    def holding(self) -> Fitter:
        """The same with starts held as observed."""
        same = copy(self)
        same.held = True
        return same

    def unit(self, of: str, scale: Scale) -> float:
        """The value of one unit of a scale at a term's joint."""
        return self.scales[joint(of)].of(scale)

    def has_room(self, hypothesis: Hypothesis) -> bool:
        """Whether the lanes suffice for every number of a composition."""
        return len(self.free(hypothesis).rows) <= self._room()

    def _room(self) -> int:
        """How many numbers may be free: a family's fit in one block, a tree's take as many as they
        need."""
        return BLOCK - 1 - 2 * self.joints if self.form.family >= 0 else 1_000

    def free(self, hypothesis: Hypothesis, fixed: Iterable[tuple[str, str]] = ()) -> Free:
        """What a hypothesis leaves free, the nominal form's numbers first."""
        kept = set(fixed)
        rows: list[int] = []
        names: list[tuple[str, str]] = []
        steps: list[float] = []
        bounds: list[tuple[float, float]] = []
        along: list[Array] = []
        nothing = np.zeros(self.directions.along.shape[1])
        ways = self.directions
        for name, row, way, step, low in zip(
            ways.names, ways.alone, ways.along, ways.steps, ways.low, strict=True
        ):
            if ("", name) not in kept:
                rows.append(int(row))
                names.append(("", name))
                steps.append(float(step))
                bounds.append((float(low), np.inf))
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
        limits, moved = np.array(bounds).reshape(-1, 2), np.array(along).reshape(len(rows), -1)
        return Free(
            np.array(rows, np.int64),
            tuple(names),
            np.array(steps),
            limits[:, 0],
            limits[:, 1],
            moved,
        )

    def begin(self, parameters: Sequence[float]) -> Array:
        """A block's parameter vector in which nothing acts."""
        values = self.block.nulls.copy()
        values[: len(parameters)] = parameters
        return values

    def with_effect(self, values: Array, term: str, start: Sequence[float]) -> Array:
        """The same with one term begun at a start given in units of its scales."""
        return begun(self.block, values, self.scales[joint(term)], term, start)

    def fit(
        self,
        data: Sequence[Series],
        hypothesis: Hypothesis,
        values: Array,
        starts: Mapping[str, Start] | None = None,
        *,
        iterations: int = 12,
        fixed: Iterable[tuple[str, str]] = (),
        tolerance: float = 1e-4,
        linear: Linear | None = None,
    ) -> RolloutFit:
        """Levenberg-Marquardt from `values`.

        Where derivatives take several blocks of lanes, those by the nominal form's directions and
        by the starts are kept while steps do what they promise; `linear` are some of a fit nearby
        to begin with.
        """
        task = self._task(data, hypothesis, self.free(hypothesis, fixed))
        values = task.free.moved(values, np.zeros(len(task.free.rows)))
        samples, now = self._samples(data), self.begun(starts, data, hypothesis)
        weight, centre = self.expected(task.free)
        stale = linear is not None and task.keeps > 0
        best, linear = self._evaluate(task, values, now, linear if stale else None)
        damping, converged, astray = 1e-3, False, False
        left = iterations if np.isfinite(best.cost) else 0
        while left:
            left -= 1
            at, worth = task.free.at(values), PRIOR * best.cost / samples * weight
            step, moves, expected = best.step(
                damping, at, task.free.low, task.free.high, worth, worth * (centre - at)
            )
            if not expected > tolerance * best.cost + NEGLIGIBLE and not astray:
                if stale and tolerance < ROUGH:
                    fresh, derived = self._evaluate(task, values, now)
                    if np.isfinite(
                        fresh.cost
                    ):  # else it runs away a little further on, and this is as far as it goes
                        best, linear, stale = fresh, derived, False
                        continue
                converged = True
                break
            tried = task.free.moved(values, step)
            there = {key: moved(now[key], *move, task.states) for key, move in moves.items()}
            found, after = self._evaluate(task, tried, there, linear)
            gained = (
                best.cost
                - found.cost
                + float(worth @ ((at - centre) ** 2 - (task.free.at(tried) - centre) ** 2))
            )
            if gained > 0.0:
                good = gained > KEEPS_ITS_WORD * expected
                damping = max(
                    damping * (0.04 if gained > KEPT_IT * expected else 0.2 if good else 1.0), 1e-9
                )
                astray = False
                values, now, best, linear = tried, there, found, after
                stale = task.keeps > 0
            else:
                good = False
                astray = not found.cost < ASTRAY * best.cost
                left += astray  # it is no step
                damping = damping * 1e3 if astray else damping if stale else damping * 10.0
                if damping > 1e7:  # noqa: PLR2004  (nothing within a millionth of a step is better)
                    converged = True
                    break
            if stale and not good:
                fresh, derived = self._evaluate(task, values, now)
                if not np.isfinite(fresh.cost):
                    break
                best, linear, stale = fresh, derived, False
        n = len(task.free.rows)
        costs = np.concatenate([g[:, 0, 0] for g in best.parts.values()])
        information, scores = (
            best.reduced_with_scores()
            if np.isfinite(best.cost)
            else (np.zeros((n, n)), np.zeros((len(costs), n)))
        )
        return RolloutFit(
            hypothesis,
            values,
            task.free,
            now,
            best.cost,
            costs,
            samples,
            information,
            converged,
            scores,
        )

    def started(
        self,
        data: Sequence[Series],
        hypothesis: Hypothesis,
        values: Array,
        starts: Mapping[str, Start] | None = None,
        iterations: int = 12,
        tolerance: float = STARTED,
        *,
        fine: bool = False,
    ) -> RolloutFit:
        """What the windows start from, estimated alone: Levenberg-Marquardt with a damping of each
        window's own, for but through what hidden states remember they know nothing of each other.
        Where `fine`, differences are as wide as the log can tell.
        """
        task = self._task(data, hypothesis, self.free(hypothesis).none())
        now, converged = self.begun(starts, data, hypothesis), False
        best, _ = self._evaluate(task, values, now)
        damping = {key: np.full(len(g), 1e-3) for key, g in best.parts.items()}
        for _ in range(iterations):
            moves = best.moves(damping)
            now = self._told(now, best, self._samples(data)) if fine else now
            tried = {key: moved(now[key], *move, task.states) for key, move in moves.items()}
            found, _ = self._evaluate(task, values, tried)
            better = {
                key: found.costs(key) <= best.costs(key) * (1.0 + tolerance) + NEGLIGIBLE
                for key in now
            }
            damping = {key: damping[key] * np.where(of, 0.1, 10.0) for key, of in better.items()}
            if not all(of.all() for of in better.values()):
                for key, of in better.items():
                    past = (
                        tried[key].memory
                        if found.cost_of(key) < best.cost_of(key)
                        else now[key].memory
                    )
                    tried[key] = replace(
                        tried[key],
                        windows=np.where(of[:, None], tried[key].windows, now[key].windows),
                        memory=past,
                    )
                found, _ = self._evaluate(task, values, tried)
            before, gaining = (
                best.cost,
                [key for key in now if found.cost_of(key) < best.cost_of(key)],
            )
            now, best = {**now, **{key: tried[key] for key in gaining}}, best.mixed(found, gaining)
            settled = (
                np.isfinite(before) and not before - best.cost > tolerance * best.cost + NEGLIGIBLE
            )
            converged = settled and all(of.all() for of in better.values())
            if converged or (not gaining and (settled or not np.isfinite(before))):
                break
        costs = np.concatenate([best.costs(key) for key in now])
        nothing, none = np.zeros((0, 0)), np.zeros((len(costs), 0))
        return RolloutFit(
            hypothesis,
            values,
            task.free,
            now,
            best.cost,
            costs,
            self._samples(data),
            nothing,
            converged,
            none,
        )

    def begun(
        self, starts: Mapping[str, Start] | None, data: Sequence[Series], hypothesis: Hypothesis
    ) -> dict[str, Start]:
        """Where rollouts start: as given, or as observed; where they are held, as observed whatever
        was given, and by positions alone a joint whose velocity the log hides.
        """
        given = {s.digest: (starts or {}).get(s.digest, Start(s.begin, {})) for s in data}
        if not self.held:
            return given
        hidden = np.zeros(2 * self.joints, np.bool_)
        hidden[[self.joints + joint(t) for t in hypothesis.effects if kind(t).hides_velocity]] = (
            True
        )
        seen = np.isfinite(self.sigma)
        begun = {s.digest: np.where(hidden, s.begin_by_positions, s.begin) for s in data}
        return {
            key: replace(start, windows=np.where(seen, begun[key], start.windows))
            for key, start in given.items()
        }

    def repeated(self, values: Array, start: Start) -> Array:
        """A block of lanes `(rows, BLOCK)` that all hold the same numbers and what hidden states
        began with."""
        p = np.repeat(values[:, None], BLOCK, axis=1)
        for key, value in start.memory.items():
            p[self.block.memories[key]] += value
        return p

    def scattered(
        self,
        data: Sequence[Series],
        hypothesis: Hypothesis,
        values: Array,
        starts: Mapping[str, Start],
    ) -> dict[str, Start]:
        """Of each window of one joint the best of starts around its own, one in each lane: descent
        of a start ends in the nearest valley.

        Those of a state go as far as SCATTERED standard deviations of its noise, of one that was
        not observed as its scale.
        """
        observed = np.isfinite(self.sigma)
        free = np.flatnonzero(~observed if self.held else np.ones(2 * self.joints, np.bool_))
        sizes = (BLOCK - 1) // 2 // max(len(free), 1)
        if self.joints > 1 or not sizes:
            return dict(starts)
        reach = np.where(
            observed, SCATTERED * self.sigma, UNSEEN_SCATTERED / START_STEP * self.start_steps
        )
        lanes = np.zeros((BLOCK, 2 * self.joints))
        for i, state in enumerate(free):
            ladder = reach[state] * CLOSER ** np.arange(sizes)
            lanes[1 + 2 * sizes * i : 1 + 2 * sizes * (i + 1), state] = np.concatenate(
                [ladder, -ladder]
            )
        found = {}
        for s in data:
            start = starts[s.digest]
            p = self.repeated(values, start)
            init = start.windows[:, :, None] + lanes.T
            out = roll(s, self.form, p, switches(hypothesis, self.joints), init, starts=BLOCK - 1)
            with np.errstate(over="ignore", invalid="ignore"):
                costs = np.nan_to_num(
                    self._errors(s, hypothesis, p[:, 0]).costs(out, len(init)),
                    nan=RAN_AWAY,
                    posinf=RAN_AWAY,
                )
            best = np.argmin(rounded(costs), axis=1)
            better = costs[:, 0] - costs.min(axis=1) > max(
                1.0, costs[:, 0].sum() / max(self._samples([s]), 1)
            )
            by = np.where(better[:, None], lanes[best], 0.0)
            found[s.digest] = replace(start, windows=start.windows + by)
        return found

    def _told(self, starts: Mapping[str, Start], gram: Gram, samples: int) -> dict[str, Start]:
        """Starts with steps that are half a half-width of each by itself, no longer than the
        fitter's own."""
        if not np.isfinite(gram.cost):
            return dict(starts)
        half = SWING * TWO_SIDED * np.sqrt(max(gram.cost / samples, 1.0))
        told = {}
        for key, start in starts.items():
            power = np.diagonal(gram.parts[key], axis1=1, axis2=2)[:, -2 * self.joints :]
            steps = np.clip(
                half / np.sqrt(np.maximum(power, NOTHING)),
                FINEST * self.start_steps,
                self.start_steps,
            )
            told[key] = replace(start, steps=np.asarray(rounded(steps)))
        return told

    def _samples(self, data: Sequence[Series]) -> int:
        """Numbers that are compared."""
        return sum(
            int((s.usable & (s.window_of >= 0)[:, None] & np.isfinite(self.sigma)).sum())
            for s in data
        )

    def expected(self, free: Free) -> tuple[Array, Array]:
        """Where a robot's numbers are expected, and the inverse squares of how far from there, 0
        where nothing is known, `(free,)` each."""
        own = (
            np.array([owner == "" for owner, _ in free.names], np.bool_) & self.directions.combined
        )
        nominal = np.zeros(len(self.block.nulls))
        nominal[: len(self.directions.nominal)] = self.directions.nominal
        return np.where(own, (STEP / free.step) ** 2, 0.0), np.where(own, free.at(nominal), 0.0)

    def linear(self, data: Sequence[Series], fit: RolloutFit) -> Linear | None:
        """The derivatives of a fit that fits nearby may keep, by episode digest; none where they
        take one block anyway."""
        task = self._task(data, fit.hypothesis, self.free(fit.hypothesis))
        return self._evaluate(task, fit.values, fit.starts)[1] if task.keeps else None

    def screen(
        self,
        data: Sequence[Series],
        parent: RolloutFit,
        effect: str,
        linear: Linear | None = None,
        starts: Sequence[Sequence[float]] = (),
    ) -> Screening:
        """What a linear model expects of each start of an effect on a parent's rollouts, of its own
        ones where none are given.

        What the effect does to them is scaled by one factor, and everything that the parent leaves
        free adapts to it. One lane for each start. Where the parent's own parameters leave no lane,
        nothing can be said. `linear` are the parent's derivatives.
        """
        task = self._task(data, parent.hypothesis, self.free(parent.hypothesis))
        task = replace(
            task,
            hypothesis=parent.hypothesis | effect,
            states=(),
            keeps=task.keeps if linear else 0,
        )
        starts = starts or kind(effect).starts
        own = len(task.free.rows) - task.keeps
        room = BLOCK - 1 - own if task.keeps else self._room() - own
        if room <= 0:
            return Screening(
                np.full(len(starts), parent.cost),
                np.zeros(len(starts)),
                np.full(len(starts), np.inf),
            )
        parts = [
            self._screened(task, parent, effect, starts[i : i + room], linear)
            for i in range(0, len(starts), room)
        ]
        cost, factor, error = np.concatenate(parts, axis=1)
        return Screening(rounded(cost), factor, error)

    def _screened(
        self,
        task: _Task,
        parent: RolloutFit,
        effect: str,
        begins: Sequence[Sequence[float]],
        linear: Linear | None,
    ) -> Array:
        n, k = len(task.free.rows), len(begins)
        lanes = self._lanes(task, parent.values, task.keeps, k)
        off = list(self.block.rows(effect))
        lanes.p[off] = self.block.nulls[off, None]
        for lane, begin in zip(lanes.of[len(lanes.of) - k :], begins, strict=True):
            lanes.p[:, lane] = self.with_effect(parent.values, effect, begin)
            lanes.inverse[lane] = 1.0
        parts, *_ = self._sums(task, lanes, parent.starts, {}, linear if task.keeps else None)
        parts = {key: np.where(np.abs(g) < RAN_AWAY, g, 0.0) for key, g in parts.items()}
        normal, gradient = Gram(
            parts, {key: np.zeros(0) for key in parts}, np.zeros(0), n + k
        ).reduced(1e-9)
        found = np.array([[parent.cost] * k, [0.0] * k, [np.inf] * k])
        for i in range(k):
            columns = [*range(n), n + i]
            diagonal = np.diag(normal)[columns]
            if not diagonal[-1] > UNSEEN:
                continue
            size = np.sqrt(np.maximum(diagonal, UNSEEN))
            inverse_part = np.linalg.inv(
                normal[np.ix_(columns, columns)] / size[:, None] / size + 1e-9 * np.eye(n + 1)
            )
            by = inverse_part @ (gradient[columns] / size)
            gained = float(by @ (gradient[columns] / size)) if by[-1] > 0.0 else 0.0
            if kind(effect).zoomed:  # it does not grow in proportion: as it is, or not at all
                rest, pulled = columns[:-1], gradient[columns[:-1]] - normal[columns[:-1], n + i]
                adapted = float(
                    pulled @ np.linalg.lstsq(normal[np.ix_(rest, rest)], pulled, rcond=None)[0]
                )
                gained = 2.0 * gradient[n + i] - normal[n + i, n + i] + adapted
            found[:, i] = (
                parent.cost - gained,
                by[-1] / size[-1],
                np.sqrt(inverse_part[-1, -1]) / size[-1],
            )
        return found

    def _task(self, data: Sequence[Series], hypothesis: Hypothesis, free: Free) -> _Task:
        keys = [key for key in self.block.memories if key[0] in hypothesis.effects]
        states = tuple(keys[: max(0, self._room() - len(free.rows))])  # as far as lanes are left
        directions = sum(owner == "" for owner, _ in free.names)
        several = 1 + len(free.rows) + len(states) + 2 * self.joints > BLOCK
        return _Task(data, hypothesis, free, states, directions if several else 0)

    def _evaluate(
        self, task: _Task, values: Array, starts: Mapping[str, Start], old: Linear | None = None
    ) -> tuple[Gram, Linear | None]:
        """The normal equations at a place, and what may be kept of them; with old derivatives,
        those are kept."""
        lanes = self._lanes(task, values, task.keeps if old else 0, len(task.states))
        return self._equations(task, lanes, starts, old)[:2]

    def _equations(
        self, task: _Task, lanes: _Lanes, starts: Mapping[str, Start], old: Linear | None = None
    ) -> tuple[Gram, Linear | None, Array]:
        """The same from lanes laid out, and what each lane costs by itself where differences are
        central, `(lanes,)`."""
        scales = np.array(
            [self.unit(t, kind(t).memory[kind(t).states.index(state)]) for t, state in task.states]
        )
        at = lanes.of[len(lanes.of) - len(task.states) :]
        pasts = {
            key: (lane, MEMORY_STEP * scale)
            for lane, key, scale in zip(at, task.states, scales, strict=True)
        }
        parts, linear, costs = self._sums(task, lanes, starts, pasts, old)
        began = {
            s.digest: np.array([starts[s.digest].memory.get(key, 0.0) for key in task.states])
            for s in task.data
        }
        return Gram(parts, began, scales, len(task.free.rows)), linear, costs

    def around(
        self,
        data: Sequence[Series],
        hypothesis: Hypothesis,
        values: Array,
        starts: Mapping[str, Start],
        free: Free,
    ) -> Around:
        """The normal equations at a place by differences on both sides, with the gradient of the
        cost itself.

        That gradient compares the costs on either side of each number: it does not see kinks that
        are finer than the numbers' steps.
        """
        task = replace(self._task(data, hypothesis, replace(free, central=True)), keeps=0)
        lanes = self._lanes(task, values, 0, len(task.states))
        gram, _, costs = self._equations(task, lanes, starts)
        n = len(free.rows)
        if not np.isfinite(gram.cost):
            return Around(gram, task.states, np.zeros(n), np.zeros(n), np.zeros(n))
        sums = np.sum([g[:, : n + 1, : n + 1].sum(axis=0) for g in gram.parts.values()], axis=0)
        up, down, per, sides = (
            costs[lanes.of[:n]],
            costs[lanes.against[:n]],
            lanes.inverse[lanes.of[:n]],
            lanes.against[:n] > 0,
        )
        return Around(
            gram,
            task.states,
            np.where(sides, 0.5 * (down - up) * per, sums[0, 1:]),
            np.where(sides, 2.0 * (up + down - 2.0 * sums[0, 0]) * per**2, np.nan),
            np.diag(sums)[1:],
        )

    def _lanes(self, task: _Task, values: Array, kept: int, more: int) -> _Lanes:
        """One lane for each free number but the first that are kept, and `more`; without any kept
        those of the start too, before them."""
        numbers = range(kept, len(task.free.rows))
        starts = 0 if kept else 2 * self.joints
        of = 1 + starts + np.arange(len(numbers) + more)
        behind = 1 + starts + len(of)
        count = -(-(behind + len(numbers) * task.free.central) // BLOCK) * BLOCK
        p = np.repeat(values[:, None], count, axis=1)
        inverse, against = np.zeros(count), np.zeros(len(of) + starts, np.int64)
        for i, (lane, which) in enumerate(zip(of, numbers, strict=False)):
            row, size = task.free.rows[which], task.free.step[which]
            if 0 <= row < self.block.nominal and not self.directions.combined:
                size *= 1.0 if task.free.central else max(1.0, abs(values[row]))
            elif row >= 0:
                size = -size if values[row] + size > task.free.high[which] else size
            task.free.nudge(p[:, lane], which, size)
            inverse[lane] = 1.0 / size
            if task.free.central and (
                row < 0 or task.free.low[which] <= values[row] - size <= task.free.high[which]
            ):
                task.free.nudge(p[:, behind + i], which, -size)
                inverse[lane], against[i] = 0.5 / size, behind + i
        free = ~np.isfinite(self.sigma[:starts]) if self.held else np.ones(starts, np.bool_)
        inverse[1 : 1 + starts] = np.where(free, 1.0 / self.start_steps[:starts], 0.0)
        return _Lanes(p, inverse, of, starts, against)

    def _sums(
        self,
        task: _Task,
        lanes: _Lanes,
        starts: Mapping[str, Start],
        pasts: Mapping[tuple[str, str], tuple[int, float]],
        old: Linear | None,
    ) -> tuple[dict[str, Array], Linear | None, Array]:
        """Sums of outer products by episode, what may be kept of them, and what each lane costs.

        `pasts` are the lanes and steps of hidden states' derivatives: inwards, for beyond its end a
        play has none.
        """
        several = lanes.p.shape[1] > BLOCK and len(task.data) > 1
        found = list(
            (in_parallel if several else map)(
                lambda s: self._sum(task, lanes, s, starts[s.digest], pasts, old), task.data
            )
        )
        linear = {
            s.digest: part
            for s, (_, part, _) in zip(task.data, found, strict=True)
            if part is not None
        }
        costs = np.sum([cost for *_, cost in found], axis=0)
        return (
            {s.digest: sums for s, (sums, *_) in zip(task.data, found, strict=True)},
            linear or None,
            costs,
        )

    def _sum(
        self,
        task: _Task,
        lanes: _Lanes,
        s: Series,
        start: Start,
        pasts: Mapping[tuple[str, str], tuple[int, float]],
        old: Linear | None,
    ) -> tuple[Array, Kept | None, Array]:
        """Those of one episode."""
        on, inverse = switches(task.hypothesis, self.joints), lanes.inverse.copy()
        block = lanes.p.copy()
        errors = self._errors(s, task.hypothesis, block[:, 0])
        for key, value in start.memory.items():
            block[self.block.memories[key]] += value
        for key, (lane, size) in pasts.items():
            inwards = -size if start.memory.get(key, 0.0) > 0.0 else size
            block[self.block.memories[key], lane] += inwards
            inverse[lane] = 1.0 / inwards
        init = np.repeat(start.windows[:, :, None], block.shape[1], axis=2)
        if old is not None:
            out = roll(s, self.form, block, on, init)
            return errors.renewed(out, inverse, lanes.of, old[s.digest]), old[s.digest], np.zeros(0)
        steps = (
            np.broadcast_to(self.start_steps, start.windows.shape)
            if start.steps is None or task.keeps
            else start.steps
        )
        for state in range(lanes.starts):
            init[:, state, 1 + state] += steps[:, state]
        out = roll(s, self.form, block, on, init, starts=lanes.starts)
        columns = np.concatenate([lanes.of, 1 + np.arange(lanes.starts)])
        sums = errors.summed(out, inverse, columns, lanes.against, len(init))
        if steps is start.steps:
            per = np.concatenate(
                [np.ones((len(steps), 1 + len(lanes.of))), self.start_steps / steps], axis=1
            )
            sums *= per[:, :, None] * per[:, None, :]
        kept = (
            errors.kept(out, inverse, columns, sums, task.keeps, len(lanes.of) + 1)
            if task.keeps
            else None
        )
        return (
            sums,
            kept,
            errors.costs(out, len(init)).sum(axis=0) if task.free.central else np.zeros(0),
        )

    def _errors(self, s: Series, hypothesis: Hypothesis, values: Array) -> Errors:
        """What a rollout of an episode is compared with."""
        window_of, weight = seen_by(s, self._late_s(hypothesis, values))
        return Errors(
            s.observed,
            weight * s.usable / self.sigma,
            window_of,
            s.t_s,
            s.period_s,
            self.correlation,
        )

    def _late_s(self, hypothesis: Hypothesis, values: Array) -> Array:
        """How late each joint is seen [s], `(joints,)`; a log of one joint does not show that apart
        from a late drive, and is shifted."""
        late_s = np.zeros(self.joints)
        for t in hypothesis.effects:
            if self.form.family < 0 and kind(t).port is Port.OBSERVATION and kind(t).delays():
                late_s[joint(t)] += values[self.block.rows(t)[0]]
        return late_s


@dataclass(frozen=True, slots=True)
class Around:
    """The normal equations at a place; `states` are the hidden ones whose past is among them.

    `gradient` `(free,)` is minus half that of the cost, what windows start from at rest, `bend`
    half its second difference, nan at a bound, and `alone` the normal equations' own diagonal
    before starts are eliminated.
    """

    gram: Gram
    states: tuple[tuple[str, str], ...]
    gradient: Array
    bend: Array
    alone: Array


@dataclass(frozen=True, slots=True)
class _Task:
    """What is fitted to what. `states` are the hidden ones whose past is estimated; of so many of
    the first free numbers the derivatives may be kept.
    """

    data: Sequence[Series]
    hypothesis: Hypothesis
    free: Free
    states: tuple[tuple[str, str], ...]
    keeps: int


@dataclass(frozen=True, slots=True)
class _Lanes:
    """Parameter vectors of lanes `(rows, lanes)` and the inverse of each one's step; so many
    `starts` follow the first, then those `of` numbers, memories and what is screened.
    """

    p: Array
    inverse: Array
    of: NDArray[np.int64]
    starts: int
    against: NDArray[np.int64]


def moved(
    start: Start, windows: Array, memory: Array, states: tuple[tuple[str, str], ...]
) -> Start:
    """A start with windows and what hidden states began with moved."""
    past = dict(start.memory)
    for key, by in zip(states, memory, strict=True):
        past[key] = past.get(key, 0.0) + float(by)
    return replace(start, windows=start.windows + windows, memory=past)


def in_parallel(work: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
    """Map over threads, in order: the kernel holds no lock."""
    with ThreadPoolExecutor(cores()) as pool:
        yield from pool.map(work, items)
