"""Logs that were spoilt on purpose, each with the name of its fault: what a recorder, a driver or a
person does to a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from io import BytesIO

import numpy as np
from mcap.writer import Writer

from tests.support.made import T0_NS
from trueup.doctor.finding import Fault
from trueup.episode.episode import Episode
from trueup.episode.layout import Field
from trueup.episode.mcap import read_episode
from trueup.episode.writer import ROS2_DEFINITION, FieldColumns, encode_cdr
from trueup.model.plant import Plant

DEGREES = 180.0 / np.pi
RPM = 60.0 / (2.0 * np.pi)
Spoil = Callable[[Plant, Sequence[Episode]], list[Episode]]


def as_recorded(plant, episode, *, late_s=0.0, kept=None, twice=None):
    """Reads an episode from a recording of it: observations stamped late, some messages missing,
    some stamps twice."""
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    schema = writer.register_schema(
        "sensor_msgs/msg/JointState", "ros2msg", ROS2_DEFINITION.encode()
    )
    layout, samples = plant.layout, len(episode.t_s)
    states, orders = FieldColumns(layout.observations), FieldColumns(layout.commands)
    seen, issued = (
        writer.register_channel(topic, "cdr", schema)
        for topic in (layout.observation_topic, layout.command_topic)
    )
    kept = np.ones(samples, bool) if kept is None else kept
    twice = np.zeros(samples, bool) if twice is None else twice
    for i in np.flatnonzero(kept):
        stamp = T0_NS + round(1e9 * float(episode.t_s[i]))
        shown = stamp + round(1e9 * late_s)
        for _ in range(1 + bool(twice[i])):
            data = encode_cdr(shown, states.joints, states.fields(episode.observations[i]))
            writer.add_message(seen, shown, data, shown)
        data = encode_cdr(stamp, orders.joints, orders.fields(episode.commands[i]))
        writer.add_message(issued, stamp, data, stamp)
    writer.add_metadata("episode", {"role": str(episode.role), **episode.conditions})
    writer.finish()
    return read_episode(stream.getvalue(), layout)


def _columns(plant, *fields):
    return [i for i, c in enumerate(plant.layout.observations) if c.field in fields]


def scaled(factor, *fields):
    """Observations of some fields times a factor."""

    def spoil(plant, episodes):
        factors = np.ones(len(plant.layout.observations))
        factors[_columns(plant, *fields)] = factor
        return [replace(e, observations=e.observations * factors) for e in episodes]

    return spoil


def commanded(factor):
    """Commands times a factor."""
    return lambda _, episodes: [replace(e, commands=factor * e.commands) for e in episodes]


def late(plant, episodes):
    """Observations stamped 30 ms late."""
    return [as_recorded(plant, e, late_s=0.03) for e in episodes]


def gap(plant, episodes):
    """A second of nothing."""
    begin = [0.4 * e.t_s[-1] for e in episodes]
    return [
        as_recorded(plant, e, kept=(e.t_s < b) | (e.t_s > b + 1.0))
        for e, b in zip(episodes, begin, strict=True)
    ]


def stuck(plant, episodes):
    """An encoder whose position and velocity stay for a while."""
    spoilt = []
    for e in episodes:
        during = (e.t_s > 0.4 * e.t_s[-1]) & (e.t_s < 0.4 * e.t_s[-1] + 1.5)
        first, seen = np.flatnonzero(during)[0], e.observations.copy()
        columns = [0, *_columns(plant, Field.VELOCITY)[:1]]
        seen[np.ix_(during, columns)] = seen[first, columns]
        spoilt.append(replace(e, observations=seen))
    return spoilt


def nowhere(plant, episodes):
    """One number in two hundred is none."""
    rng = np.random.default_rng(0)
    return [
        as_recorded(
            plant,
            replace(
                e,
                observations=np.where(
                    rng.random(e.observations.shape) < 0.005, np.nan, e.observations
                ),
            ),
        )
        for e in episodes
    ]


def lost(plant, episodes):
    """Three messages in a hundred are lost."""
    rng = np.random.default_rng(1)
    return [as_recorded(plant, e, kept=rng.random(len(e.t_s)) > 0.03) for e in episodes]


def twice(plant, episodes):
    """One message in a hundred was recorded twice."""
    rng = np.random.default_rng(2)
    return [as_recorded(plant, e, twice=rng.random(len(e.t_s)) < 0.01) for e in episodes]


def spiked(_, episodes):
    """Some positions half a range off."""
    rng, spoilt = np.random.default_rng(3), []
    for e in episodes:
        seen, span = e.observations.copy(), np.ptp(e.observations[:, 0])
        at = rng.choice(np.arange(10, len(seen) - 10, 10), 4, replace=False)
        seen[at, 0] += 0.5 * span * rng.choice([-1.0, 1.0], 4)
        spoilt.append(replace(e, observations=seen))
    return spoilt


def beyond(plant, episodes):
    """Commands that now and then are half as large again as their limits."""
    return [
        replace(
            e,
            commands=np.where(
                np.arange(len(e.t_s))[:, None] % 50 < 2, 1.5 * plant.limits[1], e.commands
            ),
        )
        for e in episodes
    ]


def slow_clock(_, episodes):
    """A loop that ran at four fifths of the declared rate."""
    return [replace(e, t_s=1.25 * e.t_s) for e in episodes]


def clipped(_, episodes):
    """Positions cut off where a twelfth of them lie."""
    high = np.quantile(np.concatenate([e.observations[:, 0] for e in episodes]), 0.92)
    spoilt = []
    for e in episodes:
        seen = e.observations.copy()
        seen[:, 0] = np.minimum(seen[:, 0], high)
        spoilt.append(replace(e, observations=seen))
    return spoilt


def shifted_velocity(plant, episodes):
    """Velocities with a constant added."""
    columns = _columns(plant, Field.VELOCITY)
    by = np.zeros(len(plant.layout.observations))
    by[columns] = 0.6 * np.std(np.concatenate([e.observations for e in episodes]), axis=0)[columns]
    return [replace(e, observations=e.observations + by) for e in episodes]


def late_velocity(plant, episodes):
    """Velocities that are shown 60 ms late."""
    spoilt, columns = [], _columns(plant, Field.VELOCITY)
    for e in episodes:
        samples, seen = round(0.06 / e.period_s), e.observations.copy()
        seen[samples:, columns] = e.observations[:-samples, columns]
        spoilt.append(replace(e, observations=seen))
    return spoilt


def swapped_commands(_, episodes):
    """The commands of the first two joints exchanged."""
    return [replace(e, commands=e.commands[:, ::-1].copy()) for e in episodes]


def swapped_joints(plant, episodes):
    """What was observed of two joints exchanged."""
    order = [1, 0, 3, 2]
    return [replace(e, observations=e.observations[:, order]) for e in episodes]


EVERYWHERE: dict[str, tuple[Fault, Spoil]] = {
    "command sign": (Fault.COMMAND_SIGN, commanded(-1.0)),
    "percent": (Fault.COMMAND_SCALE, commanded(100.0)),
    "counts of a servo": (Fault.COMMAND_SCALE, commanded(885.0)),
    "beyond limits": (Fault.COMMAND_BEYOND_LIMITS, beyond),
    "late stamps": (Fault.TOPIC_OFFSET, late),
    "a gap": (Fault.GAP, gap),
    "a stuck encoder": (Fault.STUCK, stuck),
    "not a number": (Fault.MISSING_SAMPLES, nowhere),
    "lost messages": (Fault.MISSING_SAMPLES, lost),
    "stamps twice": (Fault.REPEATED_STAMPS, twice),
    "spikes": (Fault.OUTLIERS, spiked),
    "a slow clock": (Fault.CLOCK_OFF_STEP, slow_clock),
    "clipped": (Fault.CLIPPED_SENSOR, clipped),
}
ANGLES: dict[str, tuple[Fault, Spoil]] = {
    "degrees": (Fault.POSITION_UNIT, scaled(DEGREES, Field.POSITION, Field.VELOCITY)),
}
LENGTHS: dict[str, tuple[Fault, Spoil]] = {
    "millimetres": (Fault.LENGTH_UNIT, scaled(1e3, Field.POSITION, Field.VELOCITY)),
}
WITH_VELOCITY: dict[str, tuple[Fault, Spoil]] = {
    "positions in degrees": (Fault.POSITION_UNIT, scaled(DEGREES, Field.POSITION)),
    "velocity in rpm": (Fault.VELOCITY_UNIT, scaled(RPM, Field.VELOCITY)),
    "velocity in degrees": (Fault.VELOCITY_UNIT, scaled(DEGREES, Field.VELOCITY)),
    "velocity sign": (Fault.VELOCITY_SIGN, scaled(-1.0, Field.VELOCITY)),
    "velocity offset": (Fault.OFFSET, shifted_velocity),
    "late velocity": (Fault.VELOCITY_LAG, late_velocity),
}
TWO_JOINTS: dict[str, tuple[Fault, Spoil]] = {
    "commands exchanged": (Fault.JOINTS_SWAPPED, swapped_commands),
    "joints exchanged": (Fault.JOINTS_SWAPPED, swapped_joints),
}
