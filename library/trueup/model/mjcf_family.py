"""One joint as MJCF: a family is a robot of one body, and its effects are then written as a robot's
are.

    inertia      a slide of mass 1, damping c, a motor of gear b
    oscillator   the same with a spring of stiffness k
    pendulum     a hinge of inertia 1 with gravity k sin q

Forces are accelerations of the declared joint: its mass or inertia is 1, for a log of one joint
tells no other.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from trueup.model.corrected import Corrected
from trueup.model.mjcf_patch import patch
from trueup.model.mjcf_writer import Written, write
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.model.series import DECLARED, Scheme

JOINT = "joint"
FINEST_S = (
    0.002  # MuJoCo's own default step; a declared period is cut into whole parts of at most this
)
ARM_M = 0.1  # of a pendulum's centre of mass: what is left of its inertia is the body's own
LIGHT = 1e-3  # of the inertia: a body that leaves the rest to the armature
FILE = "plant.xml"


def mjcf_of_joint(model: Corrected, folder: Path, heading: Sequence[str]) -> Written:
    """A family's model with its effects as MJCF; `folder` is for files on the way. Raises
    NotInstalled without MuJoCo."""
    plant, joint = model.plant, model.plant.joints[0] or JOINT
    is_geared = "elastic_transmission" in model.hypothesis.effects
    (folder / FILE).write_text(
        nominal(plant, model.values, joint, model.scheme, is_geared=is_geared)
    )
    channels = {
        key: [{**c, "joint": joint} for c in _listed(plant.document[key])]
        for key in ("commands", "observations")
    }
    document = {
        **plant.document,
        **channels,
        "nominal": {"mjcf": FILE, "timestep_s": plant.timestep_s},
    }
    robot = Plant.from_document(resolved(document, folder))
    values = robot.block.nulls.copy()
    values[: len(robot.parameters)] = robot.parameters
    for term in model.hypothesis.effects:
        values[list(robot.block.rows(term))] = [model.values[row] for row in plant.block.rows(term)]
    return write(
        folder / FILE,
        patch(Corrected(robot, model.hypothesis, tuple(map(float, values)), model.scheme)),
        heading,
    )


def nominal(
    plant: Plant, numbers: Sequence[float], joint: str, scheme: Scheme, *, is_geared: bool = False
) -> str:
    """A family with the numbers of its form, as MJCF: stepped as declared, or as finely as the
    symmetric scheme asks for. Where it `is_geared`, the inertia is the joint's armature, of which a
    motor can have a share."""
    family = plant.family
    given = dict(zip(plant.dynamics.parameter_names, numbers, strict=False))
    low, high = (float(bound[0]) for bound in plant.limits)
    declared = scheme == DECLARED
    step_s = plant.timestep_s / (
        1 if declared else int(np.ceil(plant.timestep_s / FINEST_S - 1e-9))
    )
    gravity = f'gravity="0 0 {-given["k"] / ARM_M if family == "pendulum" else 0.0!r}"'
    how = (
        'integrator="Euler"><flag eulerdamp="disable"/></option>'
        if declared
        else 'integrator="implicitfast"/>'
    )
    hangs = family == "pendulum"
    stiffness = f' stiffness="{given["k"]!r}"' if family == "oscillator" else ""
    kind, axis = ("hinge", "0 1 0") if hangs else ("slide", "1 0 0")
    own, mass, geared = 1.0 - ARM_M**2 if hangs else 1.0, 1.0, ""
    if is_geared:
        geared = f' armature="{own - LIGHT!r}"'
        own, mass = (LIGHT, mass) if hangs else (own, LIGHT)
    inertial = (
        f'pos="0 0 {-ARM_M if hangs else 0.0!r}" mass="{mass!r}" '
        f'diaginertia="{own!r} {own!r} {own!r}"'
    )
    lines = [
        f"<mujoco model={quoteattr(plant.name)}>",
        f'  <option timestep="{step_s!r}" {gravity} {how}',
        "  <worldbody>",
        f"    <body name={quoteattr(plant.name)}>",
        (
            f'      <joint name={quoteattr(joint)} type="{kind}" axis="{axis}" '
            f'damping="{given["c"]!r}"{stiffness}{geared}/>'
        ),
        f"      <inertial {inertial}/>",
        '      <geom type="sphere" size="0.05" contype="0" conaffinity="0"/>',
        "    </body>",
        "  </worldbody>",
        "  <actuator>",
        f"    <motor name={quoteattr(plant.layout.commands[0].name)} "
        f'joint={quoteattr(joint)} gear="{given["b"]!r}" '
        f'ctrlrange="{low!r} {high!r}"/>',
        "  </actuator>",
        "</mujoco>",
    ]
    return "\n".join(lines) + "\n"


def _listed(value: object) -> list[dict[str, object]]:
    assert isinstance(value, list)
    return value
