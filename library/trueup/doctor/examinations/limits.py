"""Limits: commands beyond what the plant declares its drive to take."""

from __future__ import annotations

import numpy as np

from trueup.doctor.finding import Fault, Finding
from trueup.doctor.log import Log
from trueup.doctor.tuning import COMMAND


def examine(log: Log) -> list[Finding]:
    """Commands that a rollout clips."""
    return [f for at in range(len(log.plant.layout.commands)) for f in _of_command(log, at)]


def _of_command(log: Log, at: int) -> list[Finding]:
    channel = log.issued(at)
    if channel.limits is None:
        return []
    low, high = channel.limits
    hair = COMMAND.beyond * (high - low)
    where = [
        (e, np.flatnonzero((e.commands[:, at] < low - hair) | (e.commands[:, at] > high + hair)))
        for e in log.episodes
    ]
    many = sum(len(index) for _, index in where)
    samples = sum(len(e.t_s) for e in log.episodes)
    if many <= COMMAND.some * samples:
        return []
    spoilt = [(e, index) for e, index in where if len(index)]
    first, index = spoilt[0]
    values = log.commands(at)
    return [
        Finding(
            Fault.COMMAND_BEYOND_LIMITS,
            channel.name,
            channel.joint,
            tuple(e.digest for e, _ in spoilt),
            1.0,
            (
                f"{channel.name} goes from {values.min():.4g} to {values.max():.4g} "
                f"{channel.unit}, and {low:g} to {high:g} is declared: "
                f"{many} of {samples} samples are clipped"
            ),
            (
                "Declare the limits that the drive has, or record on the topic of applied commands "
                "what it did."
            ),
            from_s=float(first.t_s[index[0]]),
            to_s=float(first.t_s[index[-1]]),
        )
    ]
