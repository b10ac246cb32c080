"""Wave: a multisine, or noise, made into a command that is bounded, safe under every model in play,
and ends at rest.

The shape is clipped to the command's limits and slowed to its rate. The command rises from
rest, and ends in a brake that is fitted to the members and a hold until every one of them is at
rest. It is as large as the envelope, less a margin, allows under every member. Source: J. Swevers
et al., IEEE Transactions on Robotics and Automation 13 (1997), on periodic excitation of robots.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.collect.bounds import SMOOTHED, Bounds
from trueup.collect.ensemble import InPlay
from trueup.model.rounding import rounded

Array = NDArray[np.float64]
LINES = 14  # of a multisine
RISE = 0.08  # of the excitation, from rest
BRAKE = 0.25  # of the excitation, at its end
BRAKED_BY = 3  # members of each ensemble that the brake is fitted to
KNOTS = 5  # of the brake
BRAKED = 3  # times it is fitted, for its limits cut some of it off
NUDGED = 1e-3  # of the command's reach: how much a tent is pushed to see what it moves
CUT = (1.0, 2.0, 4.0)  # times the limit before a wave is cut off there
SIZES = 8  # that are tried of a wave
# of the room: what the next size is aimed at, and what the largest size takes of it
ALMOST, ENOUGH = (0.96, 0.9)
LEAST = 1e-9  # of the room, to divide by: a machine that sticks takes none
# of the largest speed under any member: what counts as rest, and what a hold waits for unless that
# takes longer than LONG
AT_REST, STILL = (0.05, 0.01)
LONG, LONGEST = 1.0, 3.0  # times the excitation: how long a hold may be
CHANGED = 0.3  # of the lines, at once
RMS = float(np.sqrt(0.5))  # of a shape: that of a sine of size 1
TOUCH = 1e-9  # of a command: it is the hold


class Shape(ABC):
    """The shape of a command, and where it is clipped, `cut`, in limits."""

    cut: float

    @abstractmethod
    def form(self, t_s: Array) -> Array:
        """The shape at times from 0 on, `(samples, joints)`, of about RMS in each joint."""

    @abstractmethod
    def changed(self, rng: np.random.Generator, by: float) -> Shape:
        """A shape a little different from this one."""


@dataclass(frozen=True)
class Noise(Shape):
    """Smoothed noise, `(samples, joints)`: what people play who design nothing."""

    series: Array
    cut: float

    @staticmethod
    def drawn(samples: int, joints: int, rng: np.random.Generator) -> Noise:
        """White noise through a first-order filter."""
        x = np.zeros((samples, joints))
        for i in range(1, samples):
            x[i] = SMOOTHED * x[i - 1] + (1.0 - SMOOTHED) * rng.standard_normal(joints)
        return Noise(_of_size(x), float(rng.choice(CUT)))

    def form(self, t_s: Array) -> Array:
        return self.series

    def changed(self, rng: np.random.Generator, by: float) -> Noise:
        samples, joints = self.series.shape
        other = Noise.drawn(samples, joints, rng)
        return Noise(_of_size(self.series + by * other.series), self.cut)


@dataclass(frozen=True)
class Wave(Shape):
    """A multisine of `(joints, LINES)` lines: frequencies [Hz], phases, sizes."""

    hertz: Array
    phases: Array
    sizes: Array
    cut: float

    def form(self, t_s: Array) -> Array:
        lines = np.sin(2.0 * np.pi * self.hertz[:, :, None] * t_s + self.phases[:, :, None])
        form = np.einsum("jl,jlt->tj", self.sizes, lines)
        return np.asarray(form / np.linalg.norm(self.sizes, axis=1))

    def changed(self, rng: np.random.Generator, by: float) -> Wave:
        some = rng.random(self.phases.shape) < CHANGED
        return Wave(
            self.hertz,
            np.where(
                some, self.phases + by * np.pi * rng.standard_normal(self.phases.shape), self.phases
            ),
            np.where(
                some, np.abs(self.sizes + by * rng.standard_normal(self.sizes.shape)), self.sizes
            ),
            float(rng.choice(CUT)) if rng.random() < by / 2.0 else self.cut,
        )


def _of_size(series: Array) -> Array:
    """A series `(samples, joints)` scaled to RMS in each joint."""
    return np.asarray(RMS * series / np.sqrt(np.mean(series**2, axis=0) + LEAST**2))


@njit(cache=True)
def followed(wanted, begin, step):  # type: ignore[no-untyped-def]
    """A command `(samples, joints)` followed from `begin` by no more than `step` a sample."""
    slow = np.empty_like(wanted)
    for j in range(wanted.shape[1]):
        now = begin[j]
        for i in range(wanted.shape[0]):
            now += min(max(wanted[i, j] - now, -step[j]), step[j])
            slow[i, j] = now
    return slow


@dataclass(frozen=True)
class Held:
    """A command `(samples, joints)` at `t_s` with a hold at its end, the motions `paths` `(members,
    samples, 2 x joints)` under it, the part of the room that they have `used`, and whether every
    member `rests` at the end."""

    t_s: Array
    command: Array
    paths: Array
    used: float
    rests: bool

    @property
    def safe(self) -> bool:
        """Whether no member leaves the envelope less its margin."""
        return self.used <= 1.0


@dataclass(frozen=True)
class Maker:
    """Makes commands of waves for machines at rest in the state `start` `(2 x joints,)` under the
    command `hold` `(joints,)`."""

    play: InPlay
    bounds: Bounds
    start: Array
    hold: Array
    members: tuple[Array, ...]

    @property
    def period_s(self) -> float:
        """The sampling period [s]."""
        return self.play.ensembles[0].plant.timestep_s

    def draw(self, rng: np.random.Generator) -> Wave:
        """A random wave."""
        low, high = self.bounds.band_hz
        joints = len(self.hold)
        lines = np.linspace(low, high, LINES)[None, :] * np.ones((joints, 1))
        return Wave(
            lines,
            rng.uniform(0.0, 2.0 * np.pi, lines.shape),
            rng.exponential(1.0, lines.shape),
            float(rng.choice(CUT)),
        )

    def noise(self, rng: np.random.Generator) -> Noise:
        """A random excitation."""
        return Noise.drawn(self.samples, len(self.hold), rng)

    @property
    def samples(self) -> int:
        """Samples of an excitation without its hold."""
        return round(self.bounds.duration_s / self.period_s) + 1

    def made(self, wave: Shape) -> tuple[Array, Array, float] | None:
        """Times, the largest safe command, and its size; None where even the smallest leaves the
        envelope.

        Motions grow about as the command does, so each size suggests the next one to try.
        """
        low, high, size = 0.0, np.inf, 1.0
        best: Held | None = None
        for _ in range(SIZES):
            held = self.sized(wave, size)
            good = held.safe and held.rests
            low, high, best = (size, high, held) if good else (low, size, best)
            if good and (size == 1.0 or held.used > ENOUGH):
                break
            guess = size * ALMOST / max(held.used, LEAST) if good or not held.safe else 0.0
            size = guess if low < guess < high else (low + min(high, 1.0)) / 2.0
        return None if best is None else (best.t_s, best.command, low)

    def sized(self, wave: Shape, size: float) -> Held:
        """The command of one size with its brake and a hold."""
        b, period, n = self.bounds, self.period_s, self.samples
        active = n - round(BRAKE * n)
        t = np.asarray(np.arange(n) * period, np.float64)
        rise = np.minimum(t / max(RISE * b.duration_s, period), 1.0)[:, None]
        reach = np.minimum(b.high - self.hold, self.hold - b.low)
        shaped = np.clip(wave.cut * rise * wave.form(t), -1.0, 1.0) * size * reach
        shaped[active:] = 0.0
        command = self._slowed(self.hold + shaped)
        return self.held(t, self._braked(t, command, active), self.members, AT_REST, LONG)

    def _slowed(self, command: Array) -> Array:
        """The command within its limits and its rate, beginning at the hold."""
        wanted = np.ascontiguousarray(np.clip(command, self.bounds.low, self.bounds.high))
        return np.asarray(followed(wanted, self.hold, self.bounds.rate * self.period_s))

    def _braked(self, t: Array, command: Array, active: int) -> Array:
        """The command with an end that brings the members nearest to rest: least squares on the
        tents of the brake."""
        n, joints = len(t), len(self.hold)
        knots = np.linspace(active, n - 1, KNOTS + 2)
        tents = np.stack(
            [np.interp(np.arange(n), knots, np.eye(KNOTS + 2)[i]) for i in range(1, KNOTS + 1)]
        )
        some = tuple(m[:, :BRAKED_BY] for m in self.members)
        reach = np.maximum(self.bounds.high - self.bounds.low, 1e-12)
        ended = self._ends(some, t, command)
        columns = []
        for j in range(joints):
            for tent in tents:
                pushed = command.copy()
                pushed[:, j] += NUDGED * reach[j] * tent
                columns.append((self._ends(some, t, pushed) - ended) / NUDGED)
        moves = np.array(columns).T
        size = 1e-3 * np.linalg.norm(moves) + 1e-12
        penalised = np.vstack([moves, size * np.eye(len(columns))])
        for again in range(BRAKED):
            by = rounded(
                np.linalg.lstsq(penalised, np.append(-ended, np.zeros(len(columns))), rcond=None)[0]
            )
            command = self._slowed(
                command + np.einsum("jk,kt->tj", by.reshape(joints, KNOTS) * reach[:, None], tents)
            )
            if again + 1 < BRAKED:
                ended = self._ends(some, t, command)
        return command

    def _ends(self, members: tuple[Array, ...], t: Array, command: Array) -> Array:
        """The distance of members' ends from their beginnings, velocities in the time of the brake,
        `(members x 2 x joints,)`."""
        joints = len(self.hold)
        last = self.play.responses(members, t, command, self.start)[:, -1] - self.start
        last[:, joints:] *= BRAKE * self.bounds.duration_s / 3.0
        return np.nan_to_num(last, nan=1e6, posinf=1e6, neginf=-1e6).ravel()

    def held(
        self, t: Array, command: Array, members: tuple[Array, ...], rest: float, longest: float
    ) -> Held:
        """The command with as long a hold as these members need to come to `rest`, a part of their
        largest speed; at the `longest`, so many times the excitation."""
        more = round(longest * self.bounds.duration_s / self.period_s)
        times = np.asarray(np.arange(len(t) + more) * self.period_s, np.float64)
        whole = self._slowed(np.concatenate([command, np.repeat(self.hold[None, :], more, axis=0)]))
        paths = self.play.responses(members, times, whole, self.start)
        # at each sample the outermost members decide how far and how fast the motion goes
        outermost = np.stack([paths.max(axis=0), paths.min(axis=0)])
        speed = np.abs(outermost[:, :, paths.shape[2] // 2 :]).max(axis=(0, 2))
        moving = np.flatnonzero(speed > rest * speed.max())
        still = np.flatnonzero((np.abs(whole - self.hold) > TOUCH).any(axis=1))
        end = max(int(moving[-1]) if len(moving) else 0, int(still[-1]) if len(still) else 0) + 2
        return Held(
            times[:end],
            whole[:end],
            paths[:, :end],
            self.bounds.used(outermost, self.start),
            end <= len(times),
        )
