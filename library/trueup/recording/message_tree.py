"""Messages as trees: which numbers a message of any type holds, and what they are called.

A message is a tree of named fields, as JSON has it. Each number in it is a signal, named by its
path. Where a list of numbers stands beside a list of names of the same length (`name`,
`joint_names`, `interface_names`), or its entries have a `name` of their own, an entry goes by its
name and not by its index: `position` 3 of a JointState is `elbow/position`. So one rule reads
JointState, JointTrajectoryControllerState, DynamicJointState, MultiDOFStateStamped and the messages
that a team wrote itself. A JointTrajectory is a row for each of its points.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from trueup.episode.layout import Field
from trueup.recording.recording import Signal

JOINT_NAMES = ("joint_names", "names", "name")  # lists of them name the entries of lists beside
INTERFACE_NAMES = "interface_names"  # of DynamicJointState: what is measured of one joint
# of a message, not of the machine: its times, and the shape of a multi-array
ABOUT = ("header", "stamp", "timestamp", "layout")
SILENT = ("interface_values", "values", "joints", "dof_states", "data")  # say nothing in a path
FIELDS = {
    "position": Field.POSITION,
    "positions": Field.POSITION,
    "velocity": Field.VELOCITY,
    "velocities": Field.VELOCITY,
    "effort": Field.EFFORT,
    "efforts": Field.EFFORT,
}
MOST_SIGNALS = 4096  # of a message: an image or a cloud of points is no motion of joints


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the walk through a message is: its path, the joint that the path names, and the names
    that lists of numbers here go by."""

    path: tuple[str, ...] = ()
    joint: str | None = None
    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()

    def at(self, key: str) -> _Place:
        return self if key in SILENT else replace(self, path=(*self.path, key))

    def entry(self, index: int, length: int) -> _Place:
        if self.interfaces and len(self.interfaces) == length:
            return replace(self, path=(*self.path, self.interfaces[index]))
        if self.joints and len(self.joints) == length:
            return self.of_joint(self.joints[index])
        return replace(self, path=(*self.path, str(index)))

    def of_joint(self, joint: str) -> _Place:
        return replace(self, joint=joint)

    @property
    def signal(self) -> Signal:
        *above, last = self.path or ("value",)
        of = FIELDS.get(last)
        name = (*above, *([self.joint] if self.joint else []), str(of) if of else last)
        return Signal("/".join(name), self.joint, of)


@dataclass(slots=True)
class Numbers:
    """The numbers of one row by the name of their signal. A number is what the reader of the
    message made of it: a value, or where it stands. `stamp` has its seconds and its nanoseconds,
    None where the message has none; `later` what is added to them, of a point of a trajectory."""

    signals: dict[str, tuple[Signal, Any]] = field(default_factory=dict)
    stamp: tuple[Any, Any] | None = None
    later: tuple[Any, Any] | None = None


def rows_of(message: Mapping[str, Any]) -> list[Numbers]:
    """The rows of a message: one, or of a trajectory one for each point; without the numbers of
    lists of more than MOST_SIGNALS."""
    points = message.get("points")
    if (
        isinstance(points, list | tuple)
        and points
        and all(isinstance(p, Mapping) and "time_from_start" in p for p in points)
    ):
        rest = {k: v for k, v in message.items() if k != "points"}
        return [
            replace(
                _numbers_of({**rest, **{k: v for k, v in p.items() if k != "time_from_start"}}),
                later=_seconds(p["time_from_start"]),
            )
            for p in points
        ]
    return [_numbers_of(message)]


def _numbers_of(message: Mapping[str, Any]) -> Numbers:
    numbers = Numbers(stamp=_stamp(message))
    for place, value in _walk(message, _Place()):
        signal = place.signal
        if signal.name in numbers.signals:  # two of one name: both by their whole path
            signal = replace(signal, name="/".join([*place.path, place.joint or ""]))
        numbers.signals.setdefault(signal.name, (signal, value))
        if len(numbers.signals) >= MOST_SIGNALS:
            break
    return numbers


def _walk(node: Mapping[str, Any], place: _Place) -> Iterator[tuple[_Place, Any]]:
    own = next((names for key in JOINT_NAMES if (names := _texts(node.get(key)))), None)
    here = replace(
        place, joints=own or place.joints, interfaces=_texts(node.get(INTERFACE_NAMES)) or ()
    )
    for key, value in node.items():
        if key in ABOUT and not place.path:
            continue
        at = here.at(key)
        if isinstance(value, Mapping):
            yield from _walk(value, at)
        elif isinstance(value, list):
            if len(value) <= MOST_SIGNALS:
                yield from _entries(value, at)
        elif value is not None and not isinstance(value, str | bytes):
            yield at, value


def _entries(values: list[Any], place: _Place) -> Iterator[tuple[_Place, Any]]:
    for i, value in enumerate(values):
        if isinstance(value, Mapping):
            name = value.get("name")
            named = isinstance(name, str) and bool(name)
            at = place.of_joint(str(name)) if named else place.entry(i, len(values))
            yield from _walk(value, at)
        elif value is not None and not isinstance(value, str | bytes | list):
            yield place.entry(i, len(values)), value


def _texts(value: Any) -> tuple[str, ...] | None:
    """A list of names, None where it is not one."""
    if isinstance(value, list) and value and all(isinstance(x, str) for x in value):
        return tuple(value)
    return None


def _stamp(message: Mapping[str, Any]) -> tuple[Any, Any] | None:
    header = message.get("header")
    holder = header if isinstance(header, Mapping) else message
    stamp = next((holder[k] for k in ("stamp", "timestamp") if k in holder), None)
    return _seconds(stamp)


def _seconds(time: Any) -> tuple[Any, Any] | None:
    """Seconds and nanoseconds of a time, None where it is none."""
    if not isinstance(time, Mapping):
        return None
    seconds = next((time[k] for k in ("sec", "secs", "seconds") if k in time), None)
    nanos = next((time[k] for k in ("nanosec", "nsec", "nsecs", "nanos") if k in time), 0)
    return None if seconds is None else (seconds, nanos)
