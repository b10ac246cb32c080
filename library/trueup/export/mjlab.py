"""mjlab: actuator configurations for MuJoCo on a GPU, and terms that randomise them.

A joint commanded by positions becomes a BuiltinPositionActuatorCfg, another a
BuiltinMotorActuatorCfg whose gear is the force for a unit of the command. Friction loss is the dry
friction in motion: MuJoCo has none that is larger at rest.
Source: mjlab 1.6, `mjlab.actuator` and `mjlab.envs.mdp.dr`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

from trueup.export.configuration import (
    Entry,
    Value,
    bounds,
    delay_steps,
    event,
    heading,
    notes,
    python_module,
)
from trueup.export.joint_drive import Drives, JointDrive

UNLIMITED = 1e9  # MuJoCo's motor takes a limit


def entries(drives: Drives, step_s: float) -> list[Entry]:
    """The configuration of each joint for a physics step [s]."""
    return [_entry(d, step_s) for d in drives.drives]


def _entry(drive: JointDrive, step_s: float) -> Entry:
    least, most = delay_steps(drive["delay"], step_s)
    limit = drive["limit"].value
    servo, gain = drive["servo"].value, drive["gain"].value
    per = (servo if drive.commands_position else gain) or 1.0  # the force for a unit of the control
    own: dict[str, Value]
    if drive.commands_position:
        limited = {} if limit == float("inf") else {"effort_limit": drive["limit"]}
        own = {"stiffness": drive["servo"], "damping": 0.0, **limited}
    else:
        own = {
            "effort_limit": UNLIMITED if limit == float("inf") else drive["limit"],
            "gear": drive["gain"],
        }
    return Entry(
        drive.joint,
        "BuiltinPositionActuatorCfg" if drive.commands_position else "BuiltinMotorActuatorCfg",
        {
            "target_names_expr": (drive.joint,),
            **own,
            "armature": drive["armature"],
            "frictionloss": drive["friction"],
            "viscous_damping": drive["damping"],
            **({"delay_min_lag": least, "delay_max_lag": most} if most else {}),
        },
        gain / per,
        drive["offset"].value / per,
    )


def python(drives: Drives, step_s: float, version: str) -> str:
    """A Python module with ACTUATORS, ACTIONS and EVENTS."""
    of = entries(drives, step_s)
    return python_module(
        "Actuators for mjlab.",
        heading(drives, version, notes(drives, step_s)),
        [
            f"from mjlab.actuator import {', '.join(sorted({e.kind for e in of}))}",
            "from mjlab.envs.mdp import dr",
            "from mjlab.managers.event_manager import EventTermCfg",
            "from mjlab.managers.scene_entity_config import SceneEntityCfg",
        ],
        of,
        "the control",
        (line for d in drives.drives for line in _events(d)),
    )


def _events(drive: JointDrive) -> Iterator[str]:
    for name in ("friction", "damping", "armature"):
        if not drive[name].is_certain:
            asset = f'SceneEntityCfg("robot", joint_names=({json.dumps(drive.joint)},))'
            params = {"asset_cfg": asset, "ranges": bounds(drive[name]), "operation": '"abs"'}
            yield from event(f"{drive.joint}_{name}", f"dr.joint_{name}", params)
