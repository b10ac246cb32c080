"""Excitation: a bounded command that shows a model's numbers best, safe under every model still in play.

A multisine in a declared band, cut off at the command's limits and slowed to its rate, rises from rest, ends in a brake that is fitted to
the ensemble, and a hold until every member is at rest. Each is as large as the envelope, less a margin, allows under every member. Of many
such waves the one is chosen, and then improved, that needs the fewest samples beside a random excitation, for the number that gains
least, on the mean over members.
Sources: L. Pronzato, Automatica 44 (2008), on optimal experiments; J. Swevers et al., IEEE Transactions on Robotics and Automation 13
(1997), on periodic excitation of robots.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.collect.ensemble import TWO_SIDED, Ensemble
from trueup.errors import BadPlant, NotIdentifiable
from trueup.model.plant import Plant

Array = NDArray[np.float64]
MEMBERS, JUDGED = 48, 3  # that bound a wave, and that its information is a mean over
TRIED, IMPROVED = 160, 240  # waves drawn, and changes of the best
LINES = 14  # of a multisine
RISE = 0.08  # of the excitation, from rest
BRAKE = 0.25  # of the excitation, at its end
KNOTS = 5  # of the brake
BRAKED = 3  # times it is fitted, for its limits cut some of it off
CUT = (1.0, 2.0, 4.0)  # times the limit before a wave is cut off there
HALVINGS = 7
AT_REST = 0.05  # of the largest speed under any member
LONGEST_HOLD = 1.0  # times the excitation
CHANGED = 0.3  # of the lines, at once
TOUCH = 1e-9  # of a command: it is the hold
SETTLED_S, SETTLED = 60.0, 1e-3  # within which time, and to which part of the largest speed, a machine is at rest
SMALLEST = 0.01  # of the command's reach: less is no excitation
SHRINK = 0.97
CHECKED = 1000  # members drawn anew, under each of which the final command must hold
RANDOM = 20  # random excitations of the same energy to compare with
SINGULAR = 1e-12  # of a scaled information matrix
SHARE = 0.45  # of the limit: root mean square of a random excitation to compare with while designing
SMOOTHED = 0.85  # from sample to sample, at the chapter's 0.05 s


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an excitation must keep.

    `low` and `high` of the command `(joints,)`, `rate` [command/s] `(joints,)`, `envelope` `(2 x joints, 2)` of positions and velocities
    with its `margin` taken off, `band_hz`, `duration_s` [s] without the hold at the end.
    """

    low: Array
    high: Array
    rate: Array
    envelope: Array
    margin: float
    band_hz: tuple[float, float]
    duration_s: float

    @staticmethod
    def of(plant: Plant, duration_s: float, band_hz: tuple[float, float] | None, rate: float | None, margin: float) -> Bounds:
        """A plant's own. Without a rate a command may cross its range in a fifth of the shortest period of the band."""
        if not 0.0 <= margin < 1.0 or not duration_s > 0.0:
            raise BadPlant("an excitation needs a margin from 0 to below 1 and a positive duration", field="margin")
        joints = len(plant.joints)
        low, high = (np.where(plant.command_columns >= 0, bound[plant.command_columns], 0.0) for bound in plant.limits)
        band = band_hz or (1.0 / duration_s, min(0.1 / plant.timestep_s, 20.0 / duration_s))
        envelope = np.tile([-np.inf, np.inf], (2 * joints, 1))
        for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
            if channel.name in plant.envelope:
                near, far = plant.envelope[channel.name]
                half, middle = (far - near) / 2.0, (far + near) / 2.0
                envelope[column] = middle - (1.0 - margin) * half, middle + (1.0 - margin) * half
        rates = np.full(joints, rate) if rate is not None else 5.0 * band[1] * np.maximum(high - low, 1e-12)
        return Bounds(low, high, rates, envelope, margin, band, duration_s)


@dataclass(frozen=True, slots=True)
class Information:
    """What an excitation would tell of each unknown number: the half-width of its 95 % interval, in its own unit."""

    rank: int
    condition: float
    half_widths: dict[str, float]

    def document(self) -> dict[str, Json]:
        """The same as JSON; what is not determined is null."""
        widths: dict[str, Json] = {n: w if np.isfinite(w) else None for n, w in self.half_widths.items()}
        return {"rank": self.rank, "condition": self.condition if np.isfinite(self.condition) else None, "half_widths": widths}


@dataclass(frozen=True)
class Excitation:
    """A designed command `(samples, joints)` at `t_s` [s], from the state `start`, with what it promises.

    `paths` `(members, samples, 2 x joints)` are the motions under members drawn anew; `breaches` how many of them leave the declared
    envelope; `random` the information of random excitations of the same energy.
    """

    t_s: Array
    command: Array
    start: Array
    information: Information
    random: Information
    paths: Array
    breaches: int
    used: float
    bounds: Bounds

    def document(self) -> dict[str, Json]:
        """The same as JSON, without the samples."""
        return {
            "samples": len(self.t_s),
            "duration_s": float(self.t_s[-1]),
            "band_hz": list(self.bounds.band_hz),
            "margin": self.bounds.margin,
            "rate": [float(x) for x in self.bounds.rate],
            "members": len(self.paths),
            "breaches": self.breaches,
            "envelope_used": self.used if np.isfinite(self.used) else None,
            "speed_at_end": float(np.abs(self.paths[:, -1, self.paths.shape[2] // 2 :]).max()),
            "information": self.information.document(),
            "random_of_same_energy": self.random.document(),
        }


def at_rest(ensemble: Ensemble, start: Array, hold: Array) -> Array:
    """The state `(2 x joints,)` in which the central model stays under the command `hold`, sought from `start`.

    Raises NotIdentifiable where it never comes to rest: such a machine must be held by a controller while it is excited.
    """
    plant = ensemble.plant
    t_s = np.asarray(np.arange(round(SETTLED_S / plant.timestep_s)) * plant.timestep_s, np.float64)
    path = ensemble.responses(ensemble.centre[:, None], t_s, np.tile(hold, (len(t_s), 1)), start)[0]
    joints = len(hold)
    speed = np.abs(path[:, joints:])
    if not np.isfinite(path).all() or speed[-1].max() > SETTLED * max(float(speed.max()), SETTLED):
        raise NotIdentifiable(
            "under a constant command the machine does not come to rest",
            hint="Excite it through its controller: describe the loop as a position servo, or add the wave to a trajectory.",
        )
    return np.concatenate([path[-1, :joints], np.zeros(joints)])


def design(
    ensemble: Ensemble,
    bounds: Bounds,
    noise: Array,
    start: Array,
    hold: Array,
    rng: np.random.Generator,
    progress: Callable[[str, float], None] = lambda _stage, _part: None,
    effort: float = 1.0,
) -> Excitation:
    """The excitation of a plant at rest in the state `start` `(2 x joints,)` under the command `hold` `(joints,)`.

    `noise` `(observations,)` is the standard deviation of each observation's noise; `effort` scales how many waves
    are tried. Raises NotIdentifiable where no wave is safe.
    """
    members = ensemble.drawn(MEMBERS, rng)
    maker = _Maker(ensemble, bounds, noise, start, hold, members, np.ones((JUDGED, len(ensemble.rows))))
    maker = replace(maker, random=_random_widths(maker, rng))
    best: tuple[float, _Wave] | None = None
    tried, improved = max(1, round(effort * TRIED)), round(effort * IMPROVED)
    for i in range(tried):
        wave = maker.draw(rng)
        value = maker.value(wave)
        if best is None or value > best[0]:
            best = value, wave
        progress("drawing waves", (i + 1) / tried)
    assert best is not None
    for i in range(improved):
        wave = best[1].changed(rng, 0.5 * (1.0 - i / improved) + 0.05)
        value = maker.value(wave)
        best = (value, wave) if value > best[0] else best
        progress("improving the best", (i + 1) / improved)
    if not np.isfinite(best[0]):
        raise NotIdentifiable(
            "no excitation within the bounds tells the numbers apart",
            hint="Allow a longer duration, a wider band or envelope, or leave out numbers that this machine cannot show.",
        )
    return _checked(maker, best[1], rng, progress)


@dataclass(frozen=True)
class _Wave:
    """Lines `(joints, LINES)` of a multisine: frequencies [Hz], phases, sizes; and where it is cut off, in limits."""

    hertz: Array
    phases: Array
    sizes: Array
    cut: float

    def changed(self, rng: np.random.Generator, by: float) -> _Wave:
        """The same, a little different."""
        some = rng.random(self.phases.shape) < CHANGED
        return _Wave(
            self.hertz,
            np.where(some, self.phases + by * np.pi * rng.standard_normal(self.phases.shape), self.phases),
            np.where(some, np.abs(self.sizes + by * rng.standard_normal(self.sizes.shape)), self.sizes),
            float(rng.choice(CUT)) if rng.random() < by / 2.0 else self.cut,
        )


@njit(cache=True)
def _followed(wanted, begin, step):  # type: ignore[no-untyped-def]
    """A command `(samples, joints)` followed from `begin` by no more than `step` a sample."""
    slow = np.empty_like(wanted)
    for j in range(wanted.shape[1]):
        now = begin[j]
        for i in range(wanted.shape[0]):
            now += min(max(wanted[i, j] - now, -step[j]), step[j])
            slow[i, j] = now
    return slow


@dataclass(frozen=True)
class _Maker:
    """Makes commands of waves, and says what they are worth."""

    ensemble: Ensemble
    bounds: Bounds
    noise: Array
    start: Array
    hold: Array
    members: Array
    random: Array  # widths from one sample of a random excitation under each judged member, `(members, numbers)`

    def draw(self, rng: np.random.Generator) -> _Wave:
        low, high = self.bounds.band_hz
        joints = len(self.hold)
        lines = np.linspace(low, high, LINES)[None, :] * np.ones((joints, 1))
        return _Wave(lines, rng.uniform(0.0, 2.0 * np.pi, lines.shape), rng.exponential(1.0, lines.shape), float(rng.choice(CUT)))

    def value(self, wave: _Wave) -> float:
        """How many times fewer samples it needs than a random one, for the number that gains least, on the mean over members; its
        logarithm.

        Minus infinity where the wave cannot be made safe.
        """
        made = self.made(wave)
        if made is None:
            return -np.inf
        t_s, command, _ = made
        judged = zip(self.members[:, :JUDGED].T, self.random, strict=True)
        ratios = [widths(self.fisher(member, t_s, command) / len(t_s)) / by for member, by in judged]
        return -2.0 * float(np.mean(np.log(np.max(ratios, axis=1))))

    def made(self, wave: _Wave) -> tuple[Array, Array, float] | None:
        """Times, the largest safe command, and its size; None where even the smallest leaves the envelope."""
        low, high = 0.0, 1.0
        found = self._sized(wave, high)
        if found is not None:
            return (*found, high)
        for _ in range(HALVINGS):
            size = 0.5 * (low + high)
            tried = self._sized(wave, size)
            if tried is None:
                high = size
            else:
                low, found = size, tried
        return None if found is None else (*found, low)

    def _sized(self, wave: _Wave, size: float) -> tuple[Array, Array] | None:
        """The command of one size with its brake and hold, None where a member leaves the envelope or does not come to rest."""
        plant, b = self.ensemble.plant, self.bounds
        n = round(b.duration_s / plant.timestep_s) + 1
        active = n - round(BRAKE * n)
        t = np.asarray(np.arange(n) * plant.timestep_s, np.float64)
        lines = np.sin(2.0 * np.pi * wave.hertz[:, :, None] * t + wave.phases[:, :, None])
        wave_form = np.einsum("jl,jlt->tj", wave.sizes, lines) / np.linalg.norm(wave.sizes, axis=1)
        rise = np.minimum(t / max(RISE * b.duration_s, plant.timestep_s), 1.0)[:, None]
        reach = np.minimum(b.high - self.hold, self.hold - b.low)
        shaped = np.clip(wave.cut * rise * wave_form, -1.0, 1.0) * size * reach
        shaped[active:] = 0.0
        command = self._slowed(self.hold + shaped)
        command = self._braked(t, command, active)
        return self._held(t, command)

    def _slowed(self, command: Array) -> Array:
        """The command within its limits and its rate, beginning at the hold."""
        wanted = np.ascontiguousarray(np.clip(command, self.bounds.low, self.bounds.high))
        return np.asarray(_followed(wanted, self.hold, self.bounds.rate * self.ensemble.plant.timestep_s))

    def _braked(self, t: Array, command: Array, active: int) -> Array:
        """The command with an end that brings the members nearest to rest: least squares on the tents of the brake."""
        n, joints = len(t), len(self.hold)
        knots = np.linspace(active, n - 1, KNOTS + 2)
        tents = np.stack([np.interp(np.arange(n), knots, np.eye(KNOTS + 2)[i]) for i in range(1, KNOTS + 1)])
        some = self.members[:, : max(2, JUDGED)]
        reach = np.maximum(self.bounds.high - self.bounds.low, 1e-12)
        for _ in range(BRAKED):
            ended = self._ends(some, t, command)
            columns = []
            for j in range(joints):
                for tent in tents:
                    pushed = command.copy()
                    pushed[:, j] += 1e-3 * reach[j] * tent
                    columns.append((self._ends(some, t, pushed) - ended) / 1e-3)
            design = np.array(columns).T
            size = 1e-3 * np.linalg.norm(design) + 1e-12
            by = np.linalg.lstsq(np.vstack([design, size * np.eye(len(columns))]), np.append(-ended, np.zeros(len(columns))), rcond=None)[0]
            command = command + np.einsum("jk,kt->tj", by.reshape(joints, KNOTS) * reach[:, None], tents)
            command = self._slowed(command)
        return command

    def _ends(self, members: Array, t: Array, command: Array) -> Array:
        """How far members end from where they began, velocities in the time of the brake, `(members x 2 x joints,)`."""
        joints = len(self.hold)
        last = self.ensemble.responses(members, t, command, self.start)[:, -1] - self.start
        last[:, joints:] *= BRAKE * self.bounds.duration_s / 3.0
        return np.nan_to_num(last, nan=1e6, posinf=1e6, neginf=-1e6).ravel()

    def _held(self, t: Array, command: Array) -> tuple[Array, Array] | None:
        """The command with as long a hold as every member needs to come to rest, if none leaves the envelope."""
        plant = self.ensemble.plant
        more = round(LONGEST_HOLD * self.bounds.duration_s / plant.timestep_s)
        times = np.asarray(np.arange(len(t) + more) * plant.timestep_s, np.float64)
        whole = self._slowed(np.concatenate([command, np.repeat(self.hold[None, :], more, axis=0)]))
        paths = self.ensemble.responses(self.members, times, whole, self.start)
        if not self.inside(paths):
            return None
        speed = np.abs(paths[:, :, paths.shape[2] // 2 :]).max(axis=(0, 2))
        moving = np.flatnonzero(speed > AT_REST * speed.max())
        still = np.flatnonzero((np.abs(whole - self.hold) > TOUCH).any(axis=1))
        end = max(int(moving[-1]) if len(moving) else 0, int(still[-1]) if len(still) else 0) + 2
        return None if end > len(times) else (times[:end], whole[:end])

    def inside(self, paths: Array) -> bool:
        """Whether every path keeps the envelope less its margin."""
        low, high = self.bounds.envelope.T
        return bool(((paths >= low) & (paths <= high)).all())

    def fisher(self, member: Array, t_s: Array, command: Array) -> Array:
        """Information on the unknown numbers, each in units of its own spread, `(numbers, numbers)`."""
        return self.ensemble.fisher(member, t_s, command, self.start, self.noise)

    def information(self, fisher: Array) -> Information:
        """The same as intervals."""
        size = np.sqrt(np.maximum(np.diag(fisher), 1e-300))
        scaled = fisher / size[:, None] / size
        powers = np.linalg.eigvalsh(scaled)
        rank = int((powers > 1e-10 * max(powers[-1], 1e-300)).sum())
        wide = TWO_SIDED * widths(fisher) * self.ensemble.spread
        condition = float(np.sqrt(powers[-1] / powers[0])) if powers[0] > 0.0 else np.inf
        return Information(rank, condition, dict(zip(self.ensemble.names, map(float, wide), strict=True)))


def widths(fisher: Array) -> Array:
    """Standard deviation of each number `(numbers,)` from an information matrix, infinite where it does not determine them all."""
    size = np.sqrt(np.maximum(np.diag(fisher), 1e-300))
    scaled = fisher / size[:, None] / size
    if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled)[0] < SINGULAR:
        return np.full(len(size), np.inf)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(scaled))) / size)


def _checked(maker: _Maker, wave: _Wave, rng: np.random.Generator, progress: Callable[[str, float], None]) -> Excitation:
    """The wave, made a little smaller until not one of CHECKED members drawn anew breaches the declared envelope's margin."""
    made = maker.made(wave)
    assert made is not None
    size, fresh = made[2], maker.ensemble.drawn(CHECKED, rng)
    while True:
        found = maker._sized(wave, size)
        if found is not None:
            paths = maker.ensemble.responses(fresh, found[0], found[1], maker.start)
            if maker.inside(paths):
                break
        size *= SHRINK
        if size < SMALLEST:
            raise NotIdentifiable(
                "a model still in play leaves the envelope, or never rests, under the smallest excitation",
                hint="Narrow the spread of the numbers, widen the envelope, or hold the machine where there is room.",
            )
        progress("checking on members drawn anew", 0.5)
    t_s, command = found
    low, high = _declared(maker.bounds)
    outside = ~((paths >= low) & (paths <= high)).all(axis=(1, 2))
    declared = np.isfinite(low)
    middle, half = (high[declared] + low[declared]) / 2.0, (high[declared] - low[declared]) / 2.0
    used = float((np.abs(paths[:, :, declared] - middle) / half).max(initial=0.0)) if declared.any() else float("nan")
    centre = maker.ensemble.centre
    told = maker.information(maker.fisher(centre, t_s, command))
    progress("comparing with random ones", 0.9)
    mean = np.mean([maker.fisher(centre, t_s, _random(maker, t_s, command, rng)) for _ in range(RANDOM)], axis=0)
    return Excitation(t_s, command, maker.start, told, maker.information(mean), paths, int(outside.sum()), used, maker.bounds)


def _random_widths(maker: _Maker, rng: np.random.Generator) -> Array:
    """Widths from one sample of a random excitation under each judged member, `(members, numbers)`."""
    b, plant = maker.bounds, maker.ensemble.plant
    t_s = np.asarray(np.arange(round(b.duration_s / plant.timestep_s) + 1) * plant.timestep_s, np.float64)
    even = np.tile(maker.hold + SHARE * np.minimum(b.high - maker.hold, maker.hold - b.low), (len(t_s), 1))
    drawn = [_random(maker, t_s, even, rng) for _ in range(RANDOM)]
    return np.array([widths(np.mean([maker.fisher(m, t_s, u) for u in drawn], axis=0) / len(t_s)) for m in maker.members[:, :JUDGED].T])


def _declared(bounds: Bounds) -> tuple[Array, Array]:
    """The envelope without its margin, `(2 x joints,)` each."""
    low, high = bounds.envelope.T
    declared = np.isfinite(low)
    near, far = np.where(declared, low, 0.0), np.where(declared, high, 0.0)
    middle, half = (near + far) / 2.0, (far - near) / 2.0 / (1.0 - bounds.margin)
    return np.where(declared, middle - half, -np.inf), np.where(declared, middle + half, np.inf)


def _random(maker: _Maker, t_s: Array, command: Array, rng: np.random.Generator) -> Array:
    """Smoothed noise of the same energy, within the command's limits, `(samples, joints)`."""
    x = np.zeros_like(command)
    for i in range(1, len(x)):
        x[i] = SMOOTHED * x[i - 1] + (1.0 - SMOOTHED) * rng.standard_normal(x.shape[1])
    energy, size = np.sum((command - maker.hold) ** 2), 1.0
    for _ in range(4):  # cutting off takes some of it
        cut = np.clip(maker.hold + size * x, maker.bounds.low, maker.bounds.high)
        size *= float(np.sqrt(energy / max(np.sum((cut - maker.hold) ** 2), 1e-300)))
    return np.clip(maker.hold + size * x, maker.bounds.low, maker.bounds.high)
