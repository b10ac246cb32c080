"""What Isaac Lab and mjlab do with an actuator's configuration, as they publish it, in numpy.

The effort of a drive is kp (target - q) + kd (0 - v) + effort, clipped to its limit; a late command
is one that was issued a whole number of steps ago. Joint friction is what a solver makes of dry
friction: it holds, or takes so much of the speed in a step as it can.
"""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np

FIELDS = {
    "isaaclab": {
        "joint_names_expr", "effort_limit", "effort_limit_sim", "stiffness", "damping", "armature",
        "friction", "dynamic_friction", "viscous_friction", "min_delay", "max_delay",
    },
    "mjlab": {
        "target_names_expr", "stiffness", "damping", "effort_limit", "gear", "armature",
        "frictionloss", "viscous_damping", "delay_min_lag", "delay_max_lag",
    },
}  # fmt: skip
KINDS = {
    "isaaclab": ("ImplicitActuatorCfg", "IdealPDActuatorCfg", "DelayedPDActuatorCfg"),
    "mjlab": ("BuiltinPositionActuatorCfg", "BuiltinMotorActuatorCfg"),
}
EVENT_PARAMS = {
    "isaaclab": {
        "asset_cfg", "stiffness_distribution_params", "damping_distribution_params",
        "friction_distribution_params", "armature_distribution_params", "operation",
        "distribution",
    },
    "mjlab": {"asset_cfg", "ranges", "operation"},
}  # fmt: skip


class Anything(ModuleType):
    """A module that has whatever is asked of it, as a name."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return name


def configured(target):
    """A function that checks the arguments of a configuration, and returns them."""

    def of(kind):
        def make(**arguments):
            assert set(arguments) <= FIELDS[target], arguments
            return {"kind": kind, **arguments}

        return make

    return of


def read(text, target, monkeypatch):
    """ACTUATORS, ACTIONS and EVENTS of a module that was written, by stand-ins for what it
    imports."""
    names = {
        "isaaclab": ("isaaclab.actuators", "isaaclab.envs", "isaaclab.managers"),
        "mjlab": (
            "mjlab.actuator", "mjlab.envs", "mjlab.envs.mdp", "mjlab.managers",
            "mjlab.managers.event_manager", "mjlab.managers.scene_entity_config",
        ),
    }[target]  # fmt: skip
    for name in (target, *names):
        monkeypatch.setitem(sys.modules, name, Anything(name))
    make = configured(target)
    for kind in KINDS[target]:
        setattr(sys.modules[names[0]], kind, make(kind))

    def event(**arguments):
        assert set(arguments) == {"func", "mode", "params"}
        assert set(arguments["params"]) <= EVENT_PARAMS[target]
        return arguments

    for name in names:
        sys.modules[name].EventTermCfg = event
        sys.modules[name].SceneEntityCfg = lambda entity, joint_names: (entity, tuple(joint_names))
    if target == "isaaclab":
        sys.modules["isaaclab.envs"].mdp = Anything("mdp")
    else:
        sys.modules["mjlab.envs.mdp"].dr = Anything("dr")
    written = {}
    exec(compile(text, "written.py", "exec"), written)
    return written["ACTUATORS"], written["ACTIONS"], written["EVENTS"]


def rolled(
    config, action, commands, *, step_s, hold, inertia=1.0, spring=0.0, gravity=0.0, start=0.0
):
    """Positions at each command's end, `(commands,)`, of one joint under commands that are held for
    `hold` physics steps."""
    q, v, path = start, 0.0, []
    issued = np.repeat(action["scale"] * np.asarray(commands) + action["offset"], hold)
    late = config.get("min_delay", config.get("delay_min_lag", 0))
    issued = np.concatenate([np.full(late, issued[0]), issued])[: len(issued)]
    kp = config.get("stiffness", 0.0)
    kd = config.get("damping", 0.0) + config.get("viscous_damping", 0.0)
    limit = config.get("effort_limit", config.get("effort_limit_sim")) or np.inf
    gear = config.get("gear", 1.0)
    friction = config.get("dynamic_friction", config.get("frictionloss", 0.0))
    for i, command in enumerate(issued):
        drive = kp * (command - q) if kp else gear * command
        effort = np.clip(drive, -limit, limit) - kd * v
        free = v + step_s / inertia * (effort - spring * q - gravity * np.sin(q))
        v = np.sign(free) * max(abs(free) - step_s / inertia * friction, 0.0)
        q += step_s * v
        if (i + 1) % hold == 0:
            path.append(q)
    return np.array(path)
