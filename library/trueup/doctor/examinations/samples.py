"""Samples: values that the machine did not have: frozen, repeated, spiked or clipped.

- A channel is stuck where one value repeats while the joint travels, by its velocity or by where it
  reappears. A joint at rest repeats its value, too, and goes on from there.
- A spike is one or two samples far from both neighbours, against the noise and the channel's range.
- A clipped channel stays exactly at one end of its range, again and again.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from trueup.doctor.balance import interpolated
from trueup.doctor.finding import Fault, Finding
from trueup.doctor.log import Log
from trueup.doctor.mends import Masked
from trueup.doctor.tuning import CLOCK, KINEMATICS, SAMPLE
from trueup.episode.episode import Episode
from trueup.model.series import DISTINCT, finest_step

Array = NDArray[np.float64]
NORMAL_MAD = 1.4826  # standard deviations in a median absolute deviation


def clipped(log: Log) -> list[Finding]:
    """Channels that stay at an end of their range."""
    return [f for at in range(len(log.plant.layout.observations)) for f in _clipped(log, at)]


def stuck(log: Log) -> list[Finding]:
    """Positions that stay while their joint travels."""
    return [f for at in _channels(log, velocities=False) for f in _stuck(log, at)]


def spikes_of_positions(log: Log) -> list[Finding]:
    """Positions far from both neighbours."""
    return [f for at in _channels(log, velocities=False) for f in _outliers(log, at)]


def spikes_of_velocities(log: Log) -> list[Finding]:
    """Velocities far from both neighbours, which the positions do not show."""
    return [f for at in _channels(log, velocities=True) for f in _outliers(log, at)]


def _channels(log: Log, *, velocities: bool) -> list[int]:
    """The observations that are velocities, or those that are positions."""
    return [
        at
        for at in range(len(log.plant.layout.observations))
        if _joint_of(log, at)[1] is velocities
    ]


def runs(values: Array) -> Iterator[tuple[int, int]]:
    """First and last index of each run of one value."""
    edges = np.flatnonzero(np.diff(values) != 0.0) + 1
    yield from zip(
        np.append(0, edges).tolist(), (np.append(edges, len(values)) - 1).tolist(), strict=True
    )


def _joint_of(log: Log, at: int) -> tuple[int, bool]:
    """The joint of an observation, and whether it is its velocity."""
    column, joints = int(log.plant.state_columns[at]), len(log.plant.joints)
    return column % joints, column >= joints


def _finding(
    log: Log,
    fault: Fault,
    at: int,
    spans: list[tuple[Episode, int, int]],
    evidence: str,
    confidence: float,
) -> Finding:
    """A finding of spans of a channel, which are masked."""
    digests = tuple(dict.fromkeys(e.digest for e, _, _ in spans))
    times = tuple((e.digest, float(e.t_s[a]), float(e.t_s[b])) for e, a, b in spans)
    channel = log.observed(at)
    return Finding(
        fault,
        channel.name,
        channel.joint,
        digests,
        confidence,
        evidence,
        f"These samples of {channel.name} count no longer; nothing is put in their place.",
        (Masked(digests, at, times),),
        from_s=times[0][1],
        to_s=times[0][2] if len(times) == 1 else times[-1][2] if len(digests) == 1 else None,
    )


def _stuck(log: Log, at: int) -> list[Finding]:
    joint, _ = _joint_of(log, at)
    if not len(log.values(at)):
        return []
    spans = [(e, first, last) for e in log.episodes for first, last in _frozen(log, e, at, joint)]
    if not spans:
        return []
    e, first, last = max(spans, key=lambda s: s[0].t_s[s[2]] - s[0].t_s[s[1]])
    channel = log.observed(at)
    evidence = (
        f"{channel.name} stays at {e.observations[first, at]:.6g} {channel.unit} for "
        f"{e.t_s[last] - e.t_s[first]:.3g} s while the joint travels"
        + (f", and {len(spans) - 1} more times" if len(spans) > 1 else "")
    )
    return [_finding(log, Fault.STUCK, at, spans, evidence, 0.98)]


def _frozen(log: Log, e: Episode, at: int, joint: int) -> Iterator[tuple[int, int]]:
    """Runs of one position during which the joint travels."""
    q = e.observations[:, at]
    span = float(np.ptp(log.values(at)))
    usual = _usual_step(q)
    speeds = _speeds(log, e, joint)
    fine = usual > SAMPLE.fine * finest_step(q)
    gaps = set(e.gaps.tolist())
    for first, last in runs(q):
        long = last - first + 1 >= SAMPLE.stuck_samples
        if not long or e.t_s[last] - e.t_s[first] < SAMPLE.stuck_s:
            continue
        least = SAMPLE.stuck_travel * span
        travel = 0.0
        if speeds is not None:
            travel = abs(float(np.trapezoid(speeds[first : last + 1], e.t_s[first : last + 1])))
        goes_on = last + 1 < len(q) and last + 1 not in gaps
        jump = abs(float(q[last + 1] - q[last])) if goes_on else 0.0
        stop = abs(float(q[first] - q[first - 1])) if first > 0 and first not in gaps else 0.0
        if (
            (travel > least and travel > 2.0 * usual)
            or (jump > least and jump > SAMPLE.jump * usual)
            or (fine and jump > 0.0 and min(stop, jump) > SAMPLE.stop * usual)
        ):
            yield first, last


def _speeds(log: Log, e: Episode, joint: int) -> Array | None:
    """A joint's velocity in the unit of its position, without its offset, and 0 where it is no more
    than that of a joint at rest; None where it is not logged."""
    velocity = log.velocity(joint)
    known = log.kinematics[joint] if velocity is not None else None
    if velocity is None or known is None or abs(known.correlation) < KINEMATICS.correlated:
        return None
    logged = e.observations[:, velocity]
    v = np.nan_to_num(known.slope * (logged - known.offset))
    rest = SAMPLE.stuck_speed * abs(known.slope) * float(np.std(log.values(velocity)))
    step = abs(known.slope) * finest_step(logged)  # by so much rounding may make it larger
    return np.where(np.abs(v) > rest, np.sign(v) * np.maximum(np.abs(v) - step, 0.0), 0.0)


def _usual_step(values: Array) -> float:
    """The largest usual step of a channel that moves: of the steps that are not 0, all but the
    largest twentieth, which may be those of a fault."""
    steps = np.abs(np.diff(values))
    moving = steps[np.isfinite(steps) & (steps > 0.0)]
    return float(np.quantile(moving, SAMPLE.usual)) if len(moving) else 0.0


def _outliers(log: Log, at: int) -> list[Finding]:
    values = log.values(at)
    span = float(np.quantile(values, 0.99) - np.quantile(values, 0.01)) if len(values) else 0.0
    if span <= 0.0:
        return []
    spans = []
    joint, is_velocity = _joint_of(log, at)
    position = log.position(joint) if is_velocity else None
    for e in log.episodes:
        spikes = _spikes(e, at, span)
        spans += [
            (e, first, last)
            for first, last in spikes
            if position is None or not _travels(e, at, position, first, last)
        ]
    if not spans:
        return []
    channel = log.observed(at)
    many = sum(last - first + 1 for _, first, last in spans)
    evidence = (
        f"{many} samples of {channel.name} lie far from both of their neighbours, the first at "
        f"{spans[0][0].t_s[spans[0][1]]:.4g} s"
    )
    return [_finding(log, Fault.OUTLIERS, at, spans, evidence, 0.95)]


def _travels(e: Episode, at: int, position: int, first: int, last: int) -> bool:
    """Whether the position shows a spike of the velocity, as it does that of an impact."""
    q, v = e.observations[:, position], e.observations[:, at]
    a, b = max(first - 1, 0), min(last + 1, len(q) - 1)
    rates = np.diff(q[a : b + 1]) / np.diff(e.t_s[a : b + 1])
    beside = float(np.nanmedian(np.append(v[max(first - 3, 0) : first], v[last + 1 : last + 4])))
    away = v[first : last + 1] - beside
    largest = float(away[np.argmax(np.abs(away))])
    return bool(((rates - beside) * np.sign(largest)).max() > SAMPLE.shown * abs(largest))


def _spikes(e: Episode, at: int, span: float) -> list[tuple[int, int]]:
    """First and last sample of each spike in a channel of which most values lie in a span."""
    values = e.observations[:, at]
    reach = SAMPLE.outlier_width + 1
    known = np.isfinite(values)
    if known.sum() <= 2 * reach + 1:
        return []
    x = interpolated(e.t_s, e.t_s, values)
    padded = np.pad(x, reach, mode="edge")
    before = np.median([padded[k : k + len(x)] for k in range(reach)], axis=0)
    after = np.median([padded[reach + 1 + k :][: len(x)] for k in range(reach)], axis=0)
    # the edge of a step is near one side, a fast motion near the curve through its neighbours
    near = [padded[reach + k :][: len(x)] for k in (-2, -1, 1, 2)]
    curve = (4.0 * (near[1] + near[2]) - near[0] - near[3]) / 6.0
    aside = np.minimum(np.abs(x - before), np.abs(x - after))
    off = np.abs(x - curve)
    limit = _limit(off, x, span)
    spikes = (_peaks(off) > limit) & (2.0 * aside > limit) | (aside > _limit(aside, x, span))
    late = np.append(False, np.diff(e.t_s) > CLOCK.missing_periods * e.period_s)
    alone = ~known | late
    alone[[0, -1]] = True
    spikes &= ~_near(alone, reach)  # no neighbours on one side
    far = np.append(spikes, False)
    return [
        (first, last)
        for first, last in runs(far.astype(float))
        if far[first] and last - first < SAMPLE.outlier_width
    ]


def _near(which: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Which samples are within reach of some."""
    return np.convolve(which, np.ones(2 * reach + 1), "same") > 0.0


def _peaks(apart: Array) -> Array:
    """Distances that are larger than those of their neighbours, and 0 elsewhere: a spike moves the
    curves through its neighbours, too."""
    larger = (apart >= np.append(apart[1:], 0.0)) & (apart >= np.append(0.0, apart[:-1]))
    return np.where(larger, apart, 0.0)


def _limit(apart: Array, x: Array, span: float) -> float:
    """The distance beyond which a value is a spike, in a channel of which most lie in a span."""
    gaps = np.diff(np.unique(x))
    return max(
        SAMPLE.outlier * NORMAL_MAD * float(np.median(apart)),
        SAMPLE.outlier_range * span,
        SAMPLE.jump * float(np.quantile(apart, 0.95)),
        SAMPLE.quanta * float(gaps.min()) if len(gaps) else 0.0,
    )


def _clipped(log: Log, at: int) -> list[Finding]:
    values = log.values(at)
    if not len(values) or float(np.ptp(values)) == 0.0:
        return []
    for end in (float(values.max()), float(values.min())):
        if end == 0.0:  # at rest
            continue
        spans = [
            (e, first, last)
            for e in log.episodes
            for first, last in runs(e.observations[:, at])
            if e.observations[first, at] == end and last - first + 1 >= SAMPLE.clipped_run
        ]
        if not _repeats_nothing_else(log, at, end):
            many = len(np.unique(values)) >= SAMPLE.clipped_distinct
            spans = [s for s in spans if many and _cut_off(s[0].observations[:, at], s[1], s[2])]
        count = sum(last - first + 1 for _, first, last in spans)
        if len(spans) >= SAMPLE.clipped_runs and count > SAMPLE.clipped * len(values):
            channel = log.observed(at)
            evidence = (
                f"{channel.name} stays exactly at {end:.6g} {channel.unit}, the end of its range, "
                f"{len(spans)} times, {100 * count / len(values):.1f} % of its samples"
            )
            return [_finding(log, Fault.CLIPPED_SENSOR, at, spans, evidence, 0.9)]
    return []


def _repeats_nothing_else(log: Log, at: int, end: float) -> bool:
    """Whether a channel's values are so fine that it repeats none but the end of its range."""
    repeats = samples = 0
    for e in log.episodes:
        x = e.observations[:, at]
        repeats += int(np.sum((np.diff(x) == 0.0) & (x[1:] != end)))
        samples += len(x)
    return repeats < SAMPLE.repeats * samples


def _cut_off(x: Array, first: int, last: int) -> bool:
    """Whether a channel comes to the end of its range and leaves it at full speed: a joint that
    rests there does not."""
    if first < 2 or last + 2 >= len(x):  # noqa: PLR2004  (the step at the edge is a part of one)
        return False
    into, out = abs(x[first - 1] - x[first - 2]), abs(x[last + 2] - x[last + 1])
    return bool(min(into, out) > SAMPLE.edge * _usual_step(x))


def repeated(log: Log) -> list[Finding]:
    """Frames that repeat the one before in every channel, so many that the sensor is slower than
    the log."""
    repeats = [
        (e, float(np.mean((np.diff(e.observations, axis=0) == 0.0).all(axis=1))))
        for e in log.episodes
        if float(np.ptp(e.observations[:, 0])) > 0.0
    ]
    spoilt = [
        e
        for e, part in repeats
        if part > SAMPLE.repeated and _regular(e) and _is_fine(e.observations)
    ]
    if not spoilt:
        return []
    part = float(np.median([p for e, p in repeats if e in spoilt]))
    return [
        Finding(
            Fault.REPEATED_SAMPLES,
            None,
            None,
            tuple(e.digest for e in spoilt),
            0.9,
            f"{100 * part:.0f} % of the samples repeat the one before in every channel",
            "Repeated frames count no longer; log at the rate of the sensor.",
            applied=True,
        )
    ]


def _is_fine(observations: Array) -> bool:
    """Whether values are fine enough not to repeat by themselves, of those that are fresh."""
    fresh = np.append(True, (np.diff(observations, axis=0) != 0.0).any(axis=1))
    return all(
        len(np.unique(c[fresh & np.isfinite(c)])) >= DISTINCT * (fresh & np.isfinite(c)).sum()
        for c in observations.T
        if np.isfinite(c).any()
    )


def _regular(e: Episode) -> bool:
    """Whether repeated frames come at a beat, as those of a slower sensor do."""
    fresh = np.flatnonzero((np.diff(e.observations, axis=0) != 0.0).any(axis=1))
    if len(fresh) < SAMPLE.stuck_samples:
        return False
    beats = np.diff(fresh)
    beat = float(np.median(beats))
    return beat > 1.0 and bool(np.mean(beats == beat) > SAMPLE.beat)
