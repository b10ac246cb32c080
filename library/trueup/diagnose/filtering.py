"""Filtering: the gain with which a corrected model follows an episode before it predicts.

Kalman gain of the model linearised at rest, from a first sample to its steady state. What the log
does not tell, how much the machine is disturbed and whether from sample to sample or for a while,
is chosen by how well windows of the adaptation episodes are predicted, and among those that do as
well by how near the next sample is. Source: B. D. O. Anderson, J. B. Moore, Optimal Filtering
(1979), chapter 4; the doubling: B. D. O. Anderson, International Journal of Control 28 (1978).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.cores import in_parallel
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.measure import knows_beginnings, squared_errors_of, windows_of
from trueup.diagnose.tuning_of_answers import FILTER
from trueup.episode.episode import Episode
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import joint as joint_of
from trueup.model.block import kind, term
from trueup.model.corrected import Corrected, side_by_side
from trueup.model.plant import Plant
from trueup.model.series import Scheme, Series
from trueup.model.state import smoothed_states
from trueup.model.velocity_prior import VelocityPrior, velocity_prior
from trueup.model.windows import Windows

Array = NDArray[np.float64]
SETTLED = 1e-10  # of a standard deviation squared: a covariance that stands still
LOST = 1e10  # of the motion's square: no covariance that is worth a gain


# What goes with a log's first sample where no velocity is observed, and the rms of what that misses
Prior = tuple[VelocityPrior, float]


def prior_of(plant: Plant, quality: DataQuality, episodes: Sequence[Episode]) -> Prior | None:
    """The prior of velocities from adaptation episodes, None where they are observed, or of a
    robot."""
    if quality.observed.all() or len(plant.joints) > 1:
        return None
    return velocity_prior([_moments(plant, e) for e in episodes])


def corrected(
    plant: Plant,
    quality: DataQuality,
    fit: RolloutFit,
    scheme: Scheme,
    episodes: Sequence[Episode],
    prior: Prior | None,
) -> Corrected:
    """The predictor of a fit, with the gain that predicts the given adaptation episodes best."""
    hypothesis, values = fit.hypothesis, fit.values.copy()
    for at in range(len(plant.joints)):
        lattice, coarse = quality.lattices(at)
        if coarse.any():
            shown = term("sensor_quantization", at)
            hypothesis = hypothesis | shown
            values[list(plant.block.rows(shown))] = np.where(coarse, lattice, 0.0)
    model, unknown = Corrected(plant, hypothesis, tuple(float(x) for x in values), scheme), None
    if prior is not None:
        moments, unknown = prior
        model = replace(model, known=moments)
    period = episodes[0].period_s
    far, near = (
        _Compared.of(model, episodes, length, quality.motion)
        for length in (plant.horizon_s, period)
    )

    def with_gain(kind: tuple[float, bool]) -> Corrected:
        size, wanders = kind
        gain = _gain(plant, quality, model, 10.0**size, period, unknown, wanders=wanders)
        return replace(model, gain=gain)

    def predicted_all(
        kinds: Sequence[tuple[float, bool]],
    ) -> dict[tuple[float, bool], tuple[Array, Corrected]]:
        candidates = list(in_parallel(with_gain, kinds))
        errors = far.errors(candidates)
        return dict(zip(kinds, zip(errors, candidates, strict=True), strict=True))

    tried = predicted_all(
        [
            (size, wanders)
            for wanders in (False, True)
            for size in np.arange(
                FILTER.least_disturbance, FILTER.most_disturbance + 1e-9, FILTER.coarse_decades
            )
        ]
    )
    width = FILTER.coarse_decades / 2.0
    while width > FILTER.fine_decades:
        size, wanders = min(tried, key=lambda k: tried[k][0].mean())
        tried |= predicted_all([(size - width, wanders), (size + width, wanders)])
        width /= 2.0
    least = min((errors for errors, _ in tried.values()), key=lambda errors: errors.mean())
    alike = [candidate for errors, candidate in tried.values() if _as_well(errors - least)]
    nearest = [errors.mean() for errors in near.errors(alike)]
    return alike[int(np.argmin(nearest))]


@dataclass(frozen=True, slots=True)
class _Compared:
    """The windows on which the gains of a model are compared, and how rollouts over them begin,
    which is the same with every gain."""

    plant: Plant
    windows: Sequence[Windows]
    beginnings: Sequence[tuple[Series, Array]]
    motion: Array

    @staticmethod
    def of(
        model: Corrected, episodes: Sequence[Episode], length_s: float, motion: Array
    ) -> _Compared:
        windows = windows_of(model.plant, episodes, length_s, beginnings=knows_beginnings(model))
        return _Compared(model.plant, windows, [model.beginning(w) for w in windows], motion)

    def errors(self, candidates: Sequence[Corrected]) -> list[Array]:
        """Mean squared normalised error of each window, `(windows,)`, of each candidate."""
        at_once = self.plant.form.filters
        groups = [candidates[i : i + at_once] for i in range(0, len(candidates), at_once)]

        def of_group(group: Sequence[Corrected]) -> list[Array]:
            rolled = side_by_side(group, self.beginnings, self.windows)
            return [squared_errors_of(self.plant, r, self.windows, self.motion) for r in rolled]

        return [errors for group in in_parallel(of_group, groups) for errors in group]


def _as_well(worse: Array) -> bool:
    """Whether windows do not show a difference; then the gain that is nearest a sample ahead is the
    filter's."""
    return bool(worse.mean() <= FILTER.alike * worse.std() / np.sqrt(len(worse)))


def _moments(plant: Plant, episode: Episode) -> Array:
    """Position, command and velocity at each sample that has all three, `(samples, 3)`."""
    q, v = smoothed_states(plant, episode).T
    moments = np.column_stack([q, plant.applied(episode.commands)[:, 0], v])
    return np.asarray(moments[np.isfinite(moments).all(axis=1)])


def _gain(
    plant: Plant,
    quality: DataQuality,
    model: Corrected,
    size: float,
    period_s: float,
    unknown: float | None,
    *,
    wanders: bool,
) -> tuple[tuple[float, ...], ...]:
    """The gains of the first samples and the steady one, `(4, 2)` of each joint in a row, for a
    disturbance of a size: a force random from sample to sample, or one that wanders and is
    estimated. `unknown` is the standard deviation of a first velocity that nobody observed.
    """
    update = plant.dynamics.transition(np.array(model.values[: len(plant.parameters)]), period_s)
    of_joints = [
        _joint_gain(
            quality,
            j,
            update[np.ix_(at, at)],
            _hidden(model, j, period_s),
            size,
            period_s,
            unknown,
            wanders=wanders,
        )
        for j, at in ((j, quality.of_joint(j)) for j in range(len(plant.joints)))
    ]
    return tuple(tuple(float(x) for x in row) for row in np.concatenate(of_joints, axis=1))


def _joint_gain(
    quality: DataQuality,
    joint: int,
    update: Array,
    hides: _Hidden,
    size: float,
    period_s: float,
    unknown: float | None,
    *,
    wanders: bool,
) -> Array:
    """One joint's gains, `(beginning, 8)`, as if the others' motion were known; `update` is its own
    part of the linearised update."""
    at, sizes, h = quality.of_joint(joint), quality.scales[joint], period_s
    seen, deviation = quality.observed[at], np.nan_to_num(quality.noise[at])
    first = sizes.velocity if unknown is None else unknown
    # keeps the equation well scaled
    unit = np.array([sizes.position, sizes.velocity, sizes.acceleration, sizes.velocity])
    a, disturbed = np.eye(4), np.eye(4)[:, :3]
    a[:2, :2] = update
    a[:2, 2] = h * h / 2.0, h
    a[3] = hides.after * a[1] + np.array([0.0, hides.before, 0.0, hides.kept])
    disturbed[3] = hides.after * disturbed[1]
    power = (sizes.acceleration * size) ** 2
    drive = np.zeros((3, 3))
    if wanders:
        drive[2, 2] = power * h
    else:
        drive[:2, :2] = np.array([[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]]) * power
    drive = disturbed @ drive @ disturbed.T
    used = np.array([True, True, wanders, hides.kept > 0.0])
    noise = np.diag(np.maximum(deviation, 1e-6 * quality.motion[at])[seen] ** 2)
    shows = np.eye(4)[:2]
    shows[1, 3] = 1.0
    n, scaled = int(used.sum()), unit[used]
    a = a[np.ix_(used, used)] * scaled / scaled[:, None]
    drive = drive[np.ix_(used, used)] / scaled / scaled[:, None] + 1e-16 * np.eye(n)
    c = (shows[seen] * unit)[:, used]
    steady = _steady(a, c.T @ np.linalg.solve(noise, c), drive)
    p = steady.copy()
    p[:2] = p[:, :2] = 0.0
    p[[0, 1], [0, 1]] = np.where(seen, deviation, first) ** 2 / unit[:2] ** 2
    if used[3]:  # the first velocity is what the log shows, off by what hides it
        off = (hides.memory_s * sizes.acceleration / sizes.velocity) ** 2
        p[-1] = p[:, -1] = 0.0
        p[np.ix_([1, -1], [1, -1])] += off * np.array([[1.0, -1.0], [-1.0, 1.0]])
    gains = [np.zeros((n, len(c)))]  # the first sample is all that is known, and is taken as it is
    for _ in range(FILTER.beginning):
        p = a @ p @ a.T + drive
        gains.append(p @ c.T @ np.linalg.inv(c @ p @ c.T + noise))
        p = p - gains[-1] @ c @ p
    gains.append(steady @ c.T @ np.linalg.inv(c @ steady @ c.T + noise))
    rows = np.zeros((len(gains), 4, 2))
    rows[:, np.flatnonzero(used)[:, None], np.flatnonzero(seen)] = scaled[:, None] * np.stack(gains)
    return rows.reshape(-1, 8)


@dataclass(frozen=True, slots=True)
class _Hidden:
    """How what hides a velocity goes on over one sample: the part that is `kept`, and what it takes
    of the velocity `after` and `before`.

    `memory_s` [s] is the time over which it forgets.
    """

    kept: float = 0.0
    after: float = 0.0
    before: float = 0.0
    memory_s: float = 0.0


def _hidden(model: Corrected, at: int, h: float) -> _Hidden:
    """How what hides a joint's velocity goes on over `h` [s]; nothing where the log shows it."""
    for acting in model.hypothesis.effects:
        if kind(acting).hides_velocity and joint_of(acting) == at:
            values = [model.values[row] for row in model.plant.block.rows(acting)]
            kept, after, before = (
                float(kind(acting).apply(0.0, v, h, z, b, *values)[2]) for z, v, b in np.eye(3)
            )
            return _Hidden(kept, after, before, h / max(1.0 - kept, h))
    return _Hidden()


def _steady(a: Array, information: Array, drive: Array) -> Array:
    """The covariance before an observation at which a filter's own equation stands still, by
    doubling the time it has run.

    `information` is what one observation adds, `drive` the covariance that one sample of
    disturbance adds; `(states, states)` each. By hand, since scipy.linalg.solve_discrete_are
    differs by 4e-9 from one processor to another, this by 4e-13.
    """
    onward, gathered, p = a.T, information, drive
    for _ in range(FILTER.doublings):
        root = _root(p)
        power, axes = np.linalg.eigh(root.T @ gathered @ root)
        # what is left of p once it was gathered
        known = root @ (axes / (1.0 + np.maximum(power, 0.0))) @ axes.T @ root.T
        shared = np.eye(len(a)) - gathered @ known
        later = p + onward.T @ known @ onward
        gathered = gathered + onward @ shared @ gathered @ onward.T
        onward = onward @ shared @ onward
        size = np.sqrt(np.maximum(np.diag(later), 0.0))
        if (np.abs(later - p) <= SETTLED * size[:, None] * size).all():
            break
        if not (np.abs(later) < LOST).all():
            # of a hardly disturbed unstable motion rounding grows without end: what is left is
            # tried, and loses
            break
        p = later
    return p


def _root(p: Array) -> Array:
    """A matrix whose square is a covariance's, of which rounding may have made a little less than
    one."""
    power, axes = np.linalg.eigh((p + p.T) / 2.0)
    return np.asarray(axes * np.sqrt(np.maximum(power, 0.0)))
