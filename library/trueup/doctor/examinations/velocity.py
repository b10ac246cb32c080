"""Velocity: whether a logged velocity is the derivative of the logged position.

- A negative slope is a sign, a slope of degrees or revolutions a unit, of the velocity or of the
  position, whichever has such a unit.
- A velocity that follows the derivative later is filtered, or computed from older positions.
- A velocity that is not zero on average where the position stays has an offset.
"""

from __future__ import annotations

import numpy as np

from trueup.doctor.finding import Fault, Finding
from trueup.doctor.kinematics import Kinematics, kinematics
from trueup.doctor.log import Log
from trueup.doctor.mends import Moved, Scaled
from trueup.doctor.tuning import KINEMATICS
from trueup.episode.units import other_units


def examine(log: Log) -> list[Finding]:
    """Findings of velocities, joint by joint."""
    return [f for j in range(len(log.plant.joints)) for f in _of_joint(log, j)]


def _of_joint(log: Log, joint: int) -> list[Finding]:
    at = log.velocity(joint)
    if at is None:
        return []
    whole = log.kinematics[joint]
    if whole is None:
        return []
    moving = KINEMATICS.moving * float(np.std(log.values(at)))
    telling = [
        (e, own)
        for e in log.episodes
        if np.nanstd(e.observations[:, at]) > moving
        and (own := kinematics(log.plant, [e], joint)) is not None
        and abs(own.correlation) > KINEMATICS.closely
    ]
    odd = [e for e, own in telling if _is_odd(own)]
    slope = (kinematics(log.plant, odd, joint) if odd else None) or whole
    if not _is_odd(slope):
        if not _is_plain(whole):
            return []
        return [*_late(log, joint, at, whole), *_offset(log, joint, at, whole)]
    # those that tell nothing by themselves are taken to be as most are
    sound = {e.digest for e, own in telling if not _is_odd(own)}
    episodes = tuple(digest for digest in log.digests if digest not in sound)
    if len(sound) > len(odd):
        episodes = tuple(e.digest for e in odd)
    return [
        *_sign(log, joint, at, slope, episodes),
        *_unit(log, joint, at, slope, episodes),
    ]


def _is_plain(k: Kinematics) -> bool:
    return abs(k.correlation) >= KINEMATICS.correlated


def _is_odd(k: Kinematics | None) -> bool:
    """Whether a velocity is another one than its position's."""
    if k is None or not _is_plain(k):
        return False
    size = abs(k.slope)
    return k.slope < 0.0 or size > KINEMATICS.slope or size < 1.0 / KINEMATICS.slope


def _evidence(log: Log, joint: int, at: int, k: Kinematics) -> str:
    position = log.position(joint)
    name = log.observed(position).name if position is not None else "the position"
    return (
        f"the derivative of {name} is {k.slope:.4g} times {log.observed(at).name} "
        f"(correlation {abs(k.correlation):.3f} over {k.rows} averages)"
    )


def _confidence(k: Kinematics) -> float:
    """A correlation as a probability that the two show one motion."""
    return float(np.clip(abs(k.correlation), 0.0, 0.999))


def _sign(log: Log, joint: int, at: int, k: Kinematics, episodes: tuple[str, ...]) -> list[Finding]:
    if k.slope > 0.0:
        return []
    name = log.observed(at).name
    return [
        Finding(
            Fault.VELOCITY_SIGN,
            name,
            log.joint(joint),
            episodes,
            _confidence(k),
            _evidence(log, joint, at, k),
            f"Change the sign of {name}.",
            (Scaled(episodes, -1.0, observations=(at,)),),
        )
    ]


def _unit(log: Log, joint: int, at: int, k: Kinematics, episodes: tuple[str, ...]) -> list[Finding]:
    size = abs(k.slope)
    if 1.0 / KINEMATICS.slope <= size <= KINEMATICS.slope:
        return []
    position = log.position(joint)
    assert position is not None
    velocity_channel, position_channel = log.observed(at), log.observed(position)
    candidates = [
        (abs(np.log(size / u.factor)), Fault.VELOCITY_UNIT, at, u.factor, u.unit)
        for u in other_units(velocity_channel.unit)
    ] + [
        (
            abs(np.log(size * u.factor)),
            Fault.LENGTH_UNIT if u.is_length else Fault.POSITION_UNIT,
            position,
            u.factor,
            u.unit,
        )
        for u in other_units(position_channel.unit)
    ]
    distance, fault, column, factor, unit = min(
        candidates, default=(np.inf, Fault.VELOCITY_UNIT, at, size, "")
    )
    if distance > np.log(KINEMATICS.matches):
        fault, column, factor, unit = Fault.VELOCITY_UNIT, at, size, ""
    channel = log.observed(column)
    advice = (
        f"{channel.name} is in {unit}, and {channel.unit} is declared: multiply it by {factor:.6g}."
        if unit
        else f"{channel.name} is in another unit than {channel.unit}: multiply it by {factor:.4g}."
    )
    return [
        Finding(
            fault,
            channel.name,
            log.joint(joint),
            episodes,
            _confidence(k),
            _evidence(log, joint, at, k),
            advice,
            (Scaled(episodes, float(factor), observations=(column,)),),
        )
    ]


def _late(log: Log, joint: int, at: int, k: Kinematics) -> list[Finding]:
    period_s = float(np.median([e.period_s for e in log.episodes]))
    least = max(KINEMATICS.lag_s, KINEMATICS.lag_samples * period_s)
    plainer = (1.0 - abs(k.at_once)) > KINEMATICS.plainer * (1.0 - abs(k.correlation))
    if abs(k.late_s) <= least or abs(k.correlation) < KINEMATICS.closely or not plainer:
        return []
    name = log.observed(at).name
    return [
        Finding(
            Fault.VELOCITY_LAG,
            name,
            log.joint(joint),
            log.digests,
            _confidence(k),
            (
                f"{name} fits the derivative of the position best {1e3 * k.late_s:.3g} ms later "
                f"(correlation {abs(k.correlation):.4f})"
            ),
            "Log an unfiltered velocity, or leave it out: it is then taken from the positions.",
        )
    ]


def _offset(log: Log, joint: int, at: int, k: Kinematics) -> list[Finding]:
    values = log.values(at)
    spread = float(np.std(values))
    if abs(k.offset) <= KINEMATICS.offset * spread or abs(k.correlation) < KINEMATICS.closely:
        return []
    channel = log.observed(at)
    return [
        Finding(
            Fault.OFFSET,
            channel.name,
            log.joint(joint),
            log.digests,
            _confidence(k),
            (
                f"{channel.name} is {k.offset:.4g} {channel.unit} larger on average than the "
                f"derivative of the position, {abs(k.offset) / spread:.2g} of its own spread"
            ),
            f"Take {k.offset:.4g} {channel.unit} off {channel.name}.",
            (Moved(log.digests, at, k.offset),),
        )
    ]
