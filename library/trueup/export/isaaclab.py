"""Isaac Lab: actuator configurations, and events that randomise them over their intervals.

A joint whose command is late becomes a DelayedPDActuatorCfg, one commanded by positions an
ImplicitActuatorCfg, another an IdealPDActuatorCfg of stiffness 0, whose efforts are the action's.
Dry friction is an effort, as Isaac Sim 5 and later have it: `friction` at rest, `dynamic_friction`
in motion. The damping of the joint stands in the drive, whose target speed is 0.
Source: isaaclab 2.3, `isaaclab.actuators` and `isaaclab.envs.mdp.events`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

from trueup.export.configuration import (
    Entry,
    as_yaml,
    bounds,
    delay_steps,
    event,
    heading,
    literal,
    notes,
    number,
    python_module,
)
from trueup.export.joint_drive import Drives, JointDrive

# What an action's scale and offset make of its command
ACTION = "the effort, or the target position,"


def entries(drives: Drives, step_s: float) -> list[Entry]:
    """The configuration of each joint for a physics step [s]."""
    return [_entry(d, step_s) for d in drives.drives]


def _entry(drive: JointDrive, step_s: float) -> Entry:
    least, most = delay_steps(drive["delay"], step_s)
    is_late = most > 0
    kind = "IdealPDActuatorCfg"
    if is_late:
        kind = "DelayedPDActuatorCfg"
    elif drive.commands_position:
        kind = "ImplicitActuatorCfg"
    limit = drive["limit"]
    limited = None if limit.value == float("inf") else limit
    servo = drive["servo"].value
    per = servo if drive.commands_position and servo else 1.0  # the force for a unit of the action
    return Entry(
        drive.joint,
        kind,
        {
            "joint_names_expr": [drive.joint],
            **({_limit_name(kind): limited} if limited else {}),
            "stiffness": drive["servo"],
            "damping": drive["damping"],
            **({"armature": drive["armature"]} if drive["armature"].value else {}),
            "friction": drive["breakaway"],
            "dynamic_friction": drive["friction"],
            **({"min_delay": least, "max_delay": most} if is_late else {}),
        },
        drive["gain"].value / per,
        drive["offset"].value / per,
    )


def _limit_name(kind: str) -> str:
    return "effort_limit_sim" if kind == "ImplicitActuatorCfg" else "effort_limit"


def python(drives: Drives, step_s: float, version: str) -> str:
    """A Python module with ACTUATORS, ACTIONS and EVENTS."""
    of = entries(drives, step_s)
    return python_module(
        "Actuators for Isaac Lab.",
        heading(drives, version, notes(drives, step_s)),
        [
            f"from isaaclab.actuators import {', '.join(sorted({e.kind for e in of}))}",
            "from isaaclab.envs import mdp",
            "from isaaclab.managers import EventTermCfg, SceneEntityCfg",
        ],
        of,
        ACTION,
        (line for d in drives.drives for line in _events(d)),
    )


# of each event of a joint its function in Isaac Lab, and what of a drive its arguments are
EVENTS = {
    "gains": ("randomize_actuator_gains", {"stiffness": "servo", "damping": "damping"}),
    "joint": ("randomize_joint_parameters", {"friction": "breakaway", "armature": "armature"}),
}


def _events(drive: JointDrive) -> Iterator[str]:
    for name, (function, arguments) in EVENTS.items():
        drawn = {
            f"{argument}_distribution_params": bounds(drive[of])
            for argument, of in arguments.items()
            if not drive[of].is_certain
        }
        if drawn:
            asset = f'SceneEntityCfg("robot", joint_names=[{json.dumps(drive.joint)}])'
            how = {"operation": '"abs"', "distribution": '"uniform"'}
            params = {"asset_cfg": asset, **drawn, **how}
            yield from event(f"{drive.joint}_{name}", f"mdp.{function}", params)


def yaml(drives: Drives, step_s: float, version: str) -> str:
    """The actuators as YAML."""
    of = entries(drives, step_s)
    lines = [
        *(f"# {line}".rstrip() for line in heading(drives, version, notes(drives, step_s))),
        *as_yaml("actuators", of),
        f"actions:  # {ACTION} is scale x command + offset",
        *(f"  {e.joint}: {{scale: {literal(e.scale)}, offset: {literal(e.offset)}}}" for e in of),
        "randomisation:  # 95 % intervals",
        *_yaml_ranges(drives),
    ]
    return "\n".join(lines) + "\n"


def _yaml_ranges(drives: Drives) -> Iterator[str]:
    for drive in drives.drives:
        yield f"  {drive.joint}:"
        for name, value in drive.numbers.items():
            if not value.is_certain:
                yield f"    {name}: [{number(value.low)}, {number(value.high)}]"
