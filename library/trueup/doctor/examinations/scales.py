"""Scales: whether positions and commands are in the declared units, signs and order.

Velocities are held against positions first; what is left here are faults of both together, which
show in the numbers that the log gives the nominal model, in the commands' limits and in the
envelope. One explanation is taken at a time, the most probable one, until none is probable.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from trueup.doctor.balance import Balance
from trueup.doctor.explanation import Explanation, most_probable
from trueup.doctor.finding import Fault, Finding
from trueup.doctor.log import Log
from trueup.doctor.mends import Permuted, Scaled
from trueup.doctor.odds import sound
from trueup.doctor.tuning import COMMAND, PRIOR
from trueup.episode.layout import Field
from trueup.episode.units import COUNTS, OtherUnit, other_units


def examine(log: Log) -> list[Finding]:
    """Findings of units, scales, signs and order of whole logs."""
    findings: list[Finding] = []
    while len(findings) <= 2 * len(log.plant.joints) and _wants_explanation(log):
        explanations = [*_units(log), *_signs(log), *_command_scales(log), *_swaps(log)]
        best = most_probable(log, explanations)
        if best is None or best.finding.confidence < PRIOR.certain:
            break
        findings.append(best.finding)
        log = best.mended
    return findings


def _wants_explanation(log: Log) -> bool:
    """Whether any joint's numbers, or a range, are not as declared."""
    commands = range(len(log.plant.layout.commands))
    positions = [p for j in range(len(log.plant.joints)) if (p := log.position(j)) is not None]
    return (
        not all(map(sound, log.balances))
        or any(log.beyond_limits(at, COMMAND.far) > COMMAND.often for at in commands)
        or any(log.beyond_envelope(at, COMMAND.far) > COMMAND.often for at in positions)
    )


def _units(log: Log) -> Iterator[Explanation]:
    """Positions in another unit, of one joint or of all that share the unit, with their velocities
    and with the commands that are positions."""
    joints = range(len(log.plant.joints))
    declared = {j: log.observed(p).unit for j in joints if (p := log.position(j)) is not None}
    for unit in dict.fromkeys(declared.values()):
        for other in other_units(unit):
            together = [j for j, u in declared.items() if u == unit]
            groups = [together] if len(together) == 1 else [together, *([j] for j in together)]
            for group in groups:
                for with_commands in (False, True):
                    explanation = _unit(log, group, other, with_commands=with_commands)
                    if explanation is not None:
                        yield explanation


def _unit(
    log: Log, joints: list[int], other: OtherUnit, *, with_commands: bool
) -> Explanation | None:
    factor = other.factor
    positions = [p for j in joints if (p := log.position(j)) is not None]
    velocities = [v for j in joints if (v := log.velocity(j)) is not None]
    commands = [
        c
        for j in joints
        if (c := log.command(j)) is not None and log.issued(c).field is Field.POSITION
    ]
    if with_commands and not commands:
        return None
    beside = sum(_range_of_position(log, p, factor) for p in positions)
    if with_commands:
        beside += sum(_range_of_command(log, c, factor) for c in commands)
    channels = [log.observed(p) for p in positions]
    fault = Fault.LENGTH_UNIT if other.is_length else Fault.POSITION_UNIT
    names = ", ".join(c.name for c in channels)
    also = [
        *(log.observed(v).name for v in velocities),
        *(log.issued(c).name for c in commands if with_commands),
    ]
    beside_text = f", and {', '.join(also)} accordingly" if also else ""
    mend = Scaled(
        log.digests,
        factor,
        observations=(*positions, *velocities),
        commands=tuple(commands) if with_commands else (),
    )
    mended = log.mended([mend])
    return Explanation(
        Finding(
            fault,
            names,
            log.joint(joints[0]) if len(joints) == 1 else None,
            log.digests,
            0.0,
            _numbers(log, mended, joints),
            (
                f"{names} was logged in {other.unit}{beside_text}; {channels[0].unit} is declared: "
                f"multiply by {factor:.6g}."
            ),
            (mend,),
        ),
        mended,
        beside,
        PRIOR.usual if other.usual else PRIOR.unusual,
    )


def _numbers(before: Log, after: Log, joints: list[int]) -> str:
    """What the command's factor is over the nominal one, as logged and once mended."""
    parts = []
    for j in joints:
        old, new = before.balances[j], after.balances[j]
        if old is not None and new is not None:
            parts.append(
                f"{_joint_words(before, j)}the command acts {old.command:.3g} times as strongly as "
                f"the nominal model says, and {new.command:.3g} times once mended; its form "
                f"explains {100 * max(old.explained, 0.0):.0f} % of the acceleration, and "
                f"{100 * max(new.explained, 0.0):.0f} % once mended"
            )
    return "; ".join(parts) or "positions lie far outside the declared envelope"


def _joint_words(log: Log, joint: int) -> str:
    return f"at {log.joint(joint)} " if log.plant.names_joints else ""


def _range_of_position(log: Log, at: int, factor: float) -> float:
    """What the envelope speaks for positions times a factor [nats]."""
    before = log.beyond_envelope(at, COMMAND.far)
    after = log.mended([Scaled(log.digests, factor, observations=(at,))]).beyond_envelope(
        at, COMMAND.far
    )
    return PRIOR.range * float(np.sign(before - after) * (max(before, after) > COMMAND.often))


def _range_of_command(log: Log, at: int, factor: float) -> float:
    """What the limits speak for a command times a factor [nats]."""
    often = log.beyond_limits(at, COMMAND.far)
    mended = log.mended([Scaled(log.digests, factor, commands=(at,))])
    after = mended.beyond_limits(at, COMMAND.far)
    return PRIOR.range * float(np.sign(often - after) * (max(often, after) > COMMAND.often))


def _signs(log: Log) -> Iterator[Explanation]:
    """Commands that drive their joints the other way: one of them, or all."""
    backward = [
        (at, j)
        for j, balance in enumerate(log.balances)
        if (at := log.command(j)) is not None
        and balance is not None
        and _drives(balance)
        and balance.command < 0.0
    ]
    groups = [[pair] for pair in backward]
    if len(backward) > 1:
        groups.append(backward)
    for group in groups:
        commands = tuple(at for at, _ in group)
        mend = Scaled(log.digests, -1.0, commands=commands)
        names = ", ".join(log.issued(at).name for at in commands)
        evidence = "; ".join(
            f"{_joint_words(log, j)}the acceleration answers {log.issued(at).name} with "
            f"{balance.command:.3g} times the nominal factor, {balance.certainty:.0f} standard "
            "errors below zero"
            for at, j in group
            if (balance := log.balances[j]) is not None
        )
        yield Explanation(
            Finding(
                Fault.COMMAND_SIGN,
                names,
                log.joint(group[0][1]) if len(group) == 1 else None,
                log.digests,
                0.0,
                evidence,
                f"Change the sign of {names}.",
                (mend,),
            ),
            log.mended([mend]),
            0.0,
            PRIOR.usual,
        )


def _drives(balance: Balance) -> bool:
    """Whether it is plain how the command acts."""
    return balance.certainty >= COMMAND.certainty and balance.of_command >= COMMAND.part


def _command_scales(log: Log) -> Iterator[Explanation]:
    """A command in percent, in counts, or in another unit."""
    for j, balance in enumerate(log.balances):
        at = log.command(j)
        if at is None or log.issued(at).limits is None:
            continue
        channel = log.issued(at)
        low, high = channel.limits or (0.0, 0.0)
        largest = float(np.abs(log.commands(at)).max())
        used = largest / max(abs(low), abs(high))
        often = log.beyond_limits(at, COMMAND.far)
        plain = (
            balance is not None
            and _drives(balance)
            and balance.command > 0.0
            and balance.of_command > COMMAND.scale_part
            and _others_hold(balance)
        )
        fitted = 1.0 / balance.command if plain and balance is not None else used
        scale = _scale(fitted, used)
        if scale is None:
            continue
        mend = Scaled(log.digests, 1.0 / scale, commands=(at,))
        yield Explanation(
            Finding(
                Fault.COMMAND_SCALE,
                channel.name,
                log.joint(j),
                log.digests,
                0.0,
                (
                    f"{channel.name} reaches {largest:.4g} {channel.unit}, {used:.3g} times its "
                    f"declared limit, and {100 * often:.0f} % of it lies beyond twice the limit"
                    + (
                        f"; its effect is {balance.command:.3g} times the nominal one"
                        if plain and balance is not None
                        else ""
                    )
                ),
                (
                    f"{channel.name} is about {scale:.4g} times as large as in "
                    f"{channel.unit or 'its unit'}: divide by {scale:.4g}."
                ),
                (mend,),
            ),
            log.mended([mend]),
            _range_of_command(log, at, 1.0 / scale),
            PRIOR.usual if often > COMMAND.often else PRIOR.scale,
        )


def _others_hold(balance: Balance) -> bool:
    """Whether the other numbers of the nominal model are about as declared: a log whose command has
    another scale shows them all the same."""
    return all(
        1.0 / COMMAND.others < ratio < COMMAND.others
        for name, ratio in balance.ratios.items()
        if name != "command" and ratio > COMMAND.certainty * balance.errors[name]
    )


def _scale(fitted: float, used: float) -> float | None:
    """By what a command is too large: the full scale of a drive's counts that fits both its effect
    and its limits, else what its effect says; None where it is nothing to speak of."""
    if max(used, fitted) <= PRIOR.off:
        return fitted if fitted < 1.0 / PRIOR.off else None
    wide = [c for c in COUNTS if c >= 0.98 * used]
    full = [c for c in wide if c <= used / 0.98]
    if full:
        return full[0]
    near = [c for c in wide if abs(np.log(c / fitted)) <= np.log(PRIOR.off)]
    return min(near, key=lambda c: abs(np.log(c / fitted)), default=max(fitted, used))


def _swaps(log: Log) -> Iterator[Explanation]:
    """Two joints exchanged: their commands, or what was observed of them."""
    observations = tuple(range(len(log.plant.layout.observations)))
    commands = tuple(range(len(log.plant.layout.commands)))
    for i, j in combinations(range(len(log.plant.joints)), 2):
        c, d = log.command(i), log.command(j)
        if c is not None and d is not None:
            mend = Permuted(log.digests, observations, _exchanged(commands, c, d))
            yield _swap(log, "commands", (i, j), mend)
        order = observations
        for a, b in ((log.position(i), log.position(j)), (log.velocity(i), log.velocity(j))):
            if a is not None and b is not None:
                order = _exchanged(order, a, b)
        if order != observations:
            mend = Permuted(log.digests, order, commands)
            yield _swap(log, "positions and velocities", (i, j), mend)


def _swap(log: Log, what: str, pair: tuple[int, int], mend: Permuted) -> Explanation:
    i, j = pair
    mended = log.mended([mend])
    before, after = log.balances, mended.balances
    shares = "; ".join(
        f"at {log.joint(k)} force and command have a squared partial correlation of "
        f"{_of_command(before[k])}, and of {_of_command(after[k])} once they are exchanged"
        for k in pair
    )
    return Explanation(
        Finding(
            Fault.JOINTS_SWAPPED,
            None,
            log.joint(i),
            log.digests,
            0.0,
            shares,
            f"Exchange the {what} of {log.joint(i)} and {log.joint(j)}.",
            (mend,),
        ),
        mended,
        0.0,
        PRIOR.usual,
    )


def _of_command(balance: Balance | None) -> str:
    return f"{balance.of_command:.2f}" if balance is not None else "nothing"


def _exchanged(order: tuple[int, ...], a: int, b: int) -> tuple[int, ...]:
    exchanged = list(order)
    exchanged[a], exchanged[b] = exchanged[b], exchanged[a]
    return tuple(exchanged)
