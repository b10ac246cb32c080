"""Isaac Lab: actuator configurations, and events that randomise them over their intervals.

A joint whose command is late becomes a DelayedPDActuatorCfg, one commanded by positions an
ImplicitActuatorCfg, another an IdealPDActuatorCfg without gains, whose efforts are the action's.
Dry friction is an effort, as Isaac Sim 5 and later have it: `friction` at rest, `dynamic_friction`
in motion. The damping of the joint stands in the drive, whose target speed is 0.
Source: isaaclab 2.3, `isaaclab.actuators` and `isaaclab.envs.mdp.events`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import ceil, floor

from trueup.export.configuration import Entry, actions, as_python, as_yaml, heading, literal, number
from trueup.export.joint_drive import Drives, JointDrive, Ranged

MODULE = "isaaclab.actuators"
GIVEN_UP = 1e-9  # of a step: rounding of a delay that is a whole number of them


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


def delay_steps(delay: Ranged, step_s: float) -> tuple[int, int]:
    """The fewest and the most steps of a delay [s]: its interval in whole steps, or the nearest one
    where that is narrower than a step."""
    if not delay.value:
        return 0, 0
    least, most = ceil(delay.low / step_s - GIVEN_UP), floor(delay.high / step_s + GIVEN_UP)
    if least > most:
        least = most = round(delay.value / step_s)
    return least, most


def python(drives: Drives, step_s: float, version: str) -> str:
    """A Python module with ACTUATORS, ACTIONS and EVENTS."""
    of = entries(drives, step_s)
    kinds = ", ".join(sorted({e.kind for e in of}))
    lines = [
        '"""Actuators for Isaac Lab.',
        "",
        *heading(drives, version, _notes(drives, step_s)),
        '"""',
        "",
        f"from {MODULE} import {kinds}",
        "from isaaclab.envs import mdp",
        "from isaaclab.managers import EventTermCfg, SceneEntityCfg",
        "",
        *as_python("ACTUATORS", of),
        "",
        "# the effort, or the target position, is scale x command + offset",
        *actions(of),
        "",
        "# draws each number from its 95 % interval, at every reset",
        "EVENTS = {",
        *(line for d in drives.drives for line in _events(d)),
        "}",
    ]
    return "\n".join(lines) + "\n"


def _notes(drives: Drives, step_s: float) -> list[str]:
    notes = [f"Delays are in physics steps of {1e3 * step_s:g} ms."]
    springs = [d.joint for d in drives.drives if abs(d["spring"].value) > 0.0]
    if springs:
        values = ", ".join(
            f"{d.joint} {number(d['spring'].value)}" for d in drives.drives if d["spring"].value
        )
        notes.append(
            f"A passive spring acts beside the drive, which the asset must hold: {values}."
        )
    return notes


def _events(drive: JointDrive) -> Iterator[str]:
    asset = f'SceneEntityCfg("robot", joint_names=[{json.dumps(drive.joint)}])'
    for name, function, ranges in (
        ("gains", "randomize_actuator_gains", {"stiffness": "servo", "damping": "damping"}),
        (
            "joint",
            "randomize_joint_parameters",
            {"friction": "breakaway", "armature": "armature"},
        ),
    ):
        given = {
            argument: drive[number_]
            for argument, number_ in ranges.items()
            if not drive[number_].is_certain
        }
        if given:
            yield f"    {json.dumps(f'{drive.joint}_{name}')}: EventTermCfg("
            yield f"        func=mdp.{function},"
            yield '        mode="reset",'
            yield "        params={"
            yield f'            "asset_cfg": {asset},'
            for argument, value in given.items():
                bounds = f"({number(value.low)}, {number(value.high)})"
                yield f'            "{argument}_distribution_params": {bounds},'
            yield '            "operation": "abs",'
            yield '            "distribution": "uniform",'
            yield "        },"
            yield "    ),"


def yaml(drives: Drives, step_s: float, version: str) -> str:
    """The actuators as YAML."""
    of = entries(drives, step_s)
    lines = [
        *(f"# {line}".rstrip() for line in heading(drives, version, _notes(drives, step_s))),
        *as_yaml("actuators", of),
        "actions:  # the effort, or the target position, is scale x command + offset",
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
