"""A tree of joints as the MJCF that the second simulator gives to MuJoCo."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.model.tree import (
    ARMATURE,
    DAMPING,
    FRAME,
    FRICTION,
    GAIN,
    GRAVITY,
    LIMIT,
    NO_LIMIT,
    OFFSET,
    PARENT,
    REST,
    SERVO,
    SLIDE,
    STIFFNESS,
    ZERO,
    Tree,
)

Array = NDArray[np.float64]
LEAST_MASS, LEAST_INERTIA = 1e-9, 1e-12  # [kg, kg m^2] MuJoCo wants some of every body that moves
HARD, STIFF = "0.9999 0.9999", 2.0  # of friction: impedance, and a time constant in fine steps


def mjcf(tree: Tree, timestep_s: float) -> str:
    """A tree as MJCF, with an actuator at each joint, for some with a gain of 0."""
    links, at_joint = tree.links, tree.at_joint
    children: dict[int, list[int]] = {}
    for j, parent in enumerate(tree.constants[:, PARENT]):
        children.setdefault(int(parent), []).append(j)

    def body(j: int) -> str:
        c, own = tree.constants[j], at_joint[j]
        inside = "".join(body(k) for k in children.get(j, []))
        return (
            f'<body pos="{_text(c[FRAME + 9 : FRAME + 12])}" '
            f'xyaxes="{_text(c[FRAME : FRAME + 6])}">'
            f'<joint name="j{j}" type="{"slide" if c[SLIDE] else "hinge"}" axis="0 0 1" '
            f'ref="{_text(c[ZERO])}" '
            f'springref="{_text(c[REST])}" '
            f'stiffness="{_text(own[STIFFNESS])}" damping="{_text(own[DAMPING])}" '
            f'armature="{_text(own[ARMATURE])}" '
            f'frictionloss="{_text(own[FRICTION])}" solimpfriction="{HARD}" '
            f'solreffriction="{_text(STIFF * timestep_s)} 1"/>'
            f"{_inertial(links[j])}{inside}</body>"
        )

    motors = "".join(
        (
            f'<general joint="j{j}" gainprm="{_text(own[GAIN])}" biastype="affine" '
            f'biasprm="{_text(c[OFFSET], -own[SERVO])} 0"'
        )
        + (f' forcerange="{_text(-c[LIMIT], c[LIMIT])}"' if c[LIMIT] < NO_LIMIT else "")
        + "/>"
        for j, (own, c) in enumerate(zip(at_joint, tree.constants, strict=True))
    )
    return (
        '<mujoco><compiler angle="radian" autolimits="true"/>'
        f'<option timestep="{_text(timestep_s)}" integrator="implicitfast" '
        f'gravity="{_text(tree.constants[0, GRAVITY : GRAVITY + 3])}"/>'
        f"<worldbody>{''.join(body(j) for j in children[-1])}</worldbody>"
        f"<actuator>{motors}</actuator></mujoco>"
    )


def _inertial(link: Array) -> str:
    """A link's ten numbers about its own centre of mass; one without mass, where two joints move
    one body, has next to none."""
    mass = max(float(link[0]), LEAST_MASS)
    at, (xx, yy, zz, xy, xz, yz) = link[1:4] / mass, link[4:]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - mass * (
        at @ at * np.eye(3) - np.outer(at, at)
    )
    about += np.eye(3) * LEAST_INERTIA * (link[0] <= LEAST_MASS)
    inertia = [*np.diag(about), about[0, 1], about[0, 2], about[1, 2]]
    return f'<inertial mass="{_text(mass)}" pos="{_text(at)}" fullinertia="{_text(inertia)}"/>'


def _text(*numbers: object) -> str:
    return " ".join(repr(float(x)) for x in np.hstack(numbers))  # type: ignore[arg-type]
