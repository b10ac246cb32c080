"""Definitions of ROS messages: read from a log, or known where the log has none.

Older bags name the types of their messages without defining them. Those of ROS itself come with
`rosbags`; of ros2_control's, which do not, the fields are listed here.
Source: ros-controls/control_msgs, the branches humble and master (2026).
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import cache
from typing import Any

from trueup.errors import NotAnEpisode, NotInstalled

# Of each type its fields, each with its description: (BASE, (kind, bound)), (NAME, type),
# (ARRAY, (description, length)) or (SEQUENCE, (description, bound)).
Types = Mapping[str, tuple[Any, list[tuple[str, Any]]]]
BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4

_TIME = [("sec", (BASE, ("int32", 0))), ("nanosec", (BASE, ("uint32", 0)))]
_NUMBERS = (SEQUENCE, ((BASE, ("float64", 0)), 0))
JOINT_STATE: Types = {
    "builtin_interfaces/msg/Time": ([], _TIME),
    "std_msgs/msg/Header": (
        [],
        [("stamp", (NAME, "builtin_interfaces/msg/Time")), ("frame_id", (BASE, ("string", 0)))],
    ),
    "sensor_msgs/msg/JointState": (
        [],
        [
            ("header", (NAME, "std_msgs/msg/Header")),
            ("name", (SEQUENCE, ((BASE, ("string", 0)), 0))),
            ("position", _NUMBERS),
            ("velocity", _NUMBERS),
            ("effort", _NUMBERS),
        ],
    ),
}

_POINT = "trajectory_msgs/JointTrajectoryPoint"
_MULTI = "trajectory_msgs/MultiDOFJointTrajectoryPoint"


def _controller_state(phases: tuple[str, ...]) -> str:
    return "\n".join(
        [
            "std_msgs/Header header",
            "string[] joint_names",
            *(f"{_POINT} {phase}" for phase in phases),
            "string[] multi_dof_joint_names",
            *(f"{_MULTI} multi_dof_{phase}" for phase in phases),
        ]
    )


# of a type that changed over the years each form, the newest first
CONTROL_MESSAGES: Mapping[str, tuple[str, ...]] = {
    "control_msgs/msg/JointTrajectoryControllerState": (
        _controller_state(("reference", "feedback", "error", "output", "desired", "actual")),
        _controller_state(("reference", "feedback", "error", "output")),
        _controller_state(("desired", "actual", "error")),
        f"std_msgs/Header header\nstring[] joint_names\n{_POINT} desired\n{_POINT} actual\n"
        f"{_POINT} error",
    ),
    "control_msgs/msg/InterfaceValue": ("string[] interface_names\nfloat64[] values",),
    "control_msgs/msg/DynamicJointState": (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] "
        "interface_values",
    ),
    "control_msgs/msg/SingleDOFState": (
        "string name\nfloat64 reference\nfloat64 feedback\nfloat64 feedback_dot\nfloat64 error\n"
        "float64 error_dot\nfloat64 time_step\nfloat64 output",
    ),
    "control_msgs/msg/MultiDOFStateStamped": (
        "std_msgs/Header header\ncontrol_msgs/SingleDOFState[] dof_states",
    ),
}
SEPARATOR = "=" * 80 + "\n"


def normalised(name: str) -> str:
    """A type's name as ROS 2 writes it: `sensor_msgs/msg/JointState`."""
    parts = [p for p in name.replace("::", "/").split("/") if p not in ("msg", "dds_")]
    return "/msg/".join([parts[0], parts[-1].removesuffix("_")]) if len(parts) > 1 else name


def typesys() -> Any:
    """The module that reads definitions. Raises NotInstalled."""
    try:
        return importlib.import_module("rosbags.typesys")
    except ImportError as error:
        raise NotInstalled(
            "reading ROS messages other than JointState needs rosbags, which is not installed",
            hint="Install it with `pip install 'trueup[ros]'`.",
        ) from error


def defined(name: str, encoding: str, text: str) -> Types:
    """The types that a definition in a log holds, with those that it needs. Raises NotAnEpisode,
    NotInstalled."""
    parser = typesys()
    try:
        if encoding == "ros2idl":
            types: dict[str, Any] = {}
            for part in text.split(SEPARATOR) if SEPARATOR in text else [text]:
                body = part.split("\n", 1)[1] if part.startswith("IDL: ") else part
                types |= parser.get_types_from_idl(body) if body.strip() else {}
        else:
            types = dict(parser.get_types_from_msg(text, normalised(name)))
    except Exception as error:
        raise NotAnEpisode(
            f"the definition of {name} cannot be read: {error}", rule="encoding"
        ) from error
    return {**types, **{k: v for k, v in _standard().items() if k not in types}}


def known(name: str) -> tuple[Types, ...]:
    """The forms of a type that a log names without defining it, the newest first; none where it is
    not known. Raises NotInstalled."""
    own = normalised(name)
    if own in CONTROL_MESSAGES:
        return tuple(defined(own, "ros2msg", text) for text in CONTROL_MESSAGES[own])
    return (_standard(),) if own in _standard() else ()


@cache
def _standard() -> dict[str, Any]:
    parser = typesys()
    types = dict(parser.get_typestore(parser.Stores.LATEST).fielddefs)
    for name in ("control_msgs/msg/InterfaceValue", "control_msgs/msg/SingleDOFState"):
        types |= parser.get_types_from_msg(CONTROL_MESSAGES[name][0], name)
    return types
