"""A robot's tree from MJCF or URDF, as MuJoCo compiles it.

MuJoCo reads the file with everything beside it, welds what has no joint, and works out masses and
frames; what is taken over are the numbers. The frames are those of the robot at its zero position.

- Hinges and slides are known; a free body or a ball joint has no place in a tree of joints with one
  number each.
- An actuator acts on one joint with a constant gain and an affine bias: motors, position and
  velocity servos.
- Contacts, limits, tendons and equality constraints are not simulated; `Compiled.left_out` names
  them.
"""

from __future__ import annotations

import hashlib
import importlib
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadPlant, NotInstalled
from trueup.model.fields import Reader
from trueup.model.tree import GAIN, JOINT, LINK, NO_LIMIT, TREE, Tree

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Compiled:
    """A robot's tree, the SHA-256 of the file it was read from, and what of it is left out."""

    tree: Tree
    sha256: str
    left_out: tuple[str, ...]


def mujoco() -> ModuleType:
    """The module. Raises NotInstalled where it is missing."""
    try:
        return importlib.import_module("mujoco")  # optional, and slow to load
    except ImportError as error:
        raise NotInstalled("reading MJCF or URDF needs MuJoCo, which is not installed") from error


def compile_file(path: Path) -> Compiled:
    """The robot in an MJCF or URDF file. Raises BadPlant where it is no robot that can be rolled
    out, NotInstalled without MuJoCo."""
    engine = mujoco()
    if not path.is_file():
        raise BadPlant(f"there is no {path.name} beside plant.json", field="nominal.mjcf")
    try:
        model = engine.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise BadPlant(f"MuJoCo cannot read {path.name}: {error}", field="nominal.mjcf") from error
    tree = tree_of(engine, model)
    return Compiled(tree, hashlib.sha256(path.read_bytes()).hexdigest(), tuple(_left_out(model)))


def with_tree(document: Any, folder: Path) -> Any:
    """A plant's document with the numbers of the MJCF that it names in a folder; as it is where it
    names none or has them already.

    Raises BadPlant, NotInstalled.
    """
    nominal = document.get("nominal") if isinstance(document, dict) else None
    if not isinstance(nominal, dict) or "mjcf" not in nominal or "tree" in nominal:
        return document
    name = Reader.of(nominal, "nominal").text("mjcf")
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise BadPlant(f"{name} lies outside the case's folder", field="nominal.mjcf")
    compiled = compile_file(path)
    numbers = {
        "tree": compiled.tree.document(),
        "sha256": compiled.sha256,
        "left_out": list(compiled.left_out),
    }
    return {**document, "nominal": {**nominal, **numbers}}


def tree_of(engine: Any, model: Any) -> Tree:
    """The tree of a compiled model. Raises BadPlant where it is not one."""
    kinds = engine.mjtJoint
    if model.njnt == 0:
        raise BadPlant("the model has no joint", field="nominal.mjcf")
    names = [model.joint(i).name or f"joint{i}" for i in range(model.njnt)]
    for name, kind in zip(names, model.jnt_type, strict=True):
        if int(kind) not in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)):
            raise BadPlant(
                f"joint {name} is free or a ball",
                field="nominal.mjcf",
                hint="Fix the base, or give the joint as hinges that follow each other.",
            )
    data = engine.MjData(model)
    data.qpos[:] = model.qpos0
    engine.mj_forward(model, data)
    link_of, axes = links(model), joint_axes(data)
    inertial = np.zeros((model.njnt, LINK))
    for body in range(1, model.nbody):
        if link_of[body] >= 0:
            inertial[link_of[body]] += seen_from(
                model, data, body, axes[link_of[body]], data.xanchor[link_of[body]]
            )
    weightless = bool(model.opt.disableflags & int(engine.mjtDisableBit.mjDSBL_GRAVITY))
    gravity = np.zeros(3) if weightless else np.array(model.opt.gravity)
    at_joint = np.zeros((model.njnt, JOINT))
    constants = np.zeros((model.njnt, TREE))
    for j in range(model.njnt):
        body = model.jnt_bodyid[j]
        parent = j - 1 if j > model.body_jntadr[body] else link_of[model.body_parentid[body]]
        turn, origin = (
            (axes[parent], data.xanchor[parent]) if parent >= 0 else (np.eye(3), np.zeros(3))
        )
        dof, at = model.jnt_dofadr[j], model.jnt_qposadr[j]
        rest = float(model.qpos_spring[at])
        at_joint[j] = (
            model.dof_armature[dof],
            np.ravel(model.dof_damping[dof])[0],
            0.0,
            0.0,
            np.ravel(model.jnt_stiffness[j])[0],
            0.0,
        )
        at_joint[j, 5] = model.dof_frictionloss[dof]
        offset, limit = _actuated(engine, model, j, names[j], at_joint[j])
        frame = [*(turn.T @ axes[j]).T.ravel(), *(turn.T @ (data.xanchor[j] - origin))]
        slides = float(model.jnt_type[j] == int(kinds.mjJNT_SLIDE))
        constants[j] = [parent, slides, *frame, model.qpos0[at], rest, offset, limit, *gravity]
        if parent < 0:
            constants[j, 2:14] = [*axes[j].T.ravel(), *data.xanchor[j]]
    if model.nu == 0:  # a URDF names no actuators: an effort acts as it is
        at_joint[:, GAIN] = 1.0
    return Tree(
        tuple(names), constants, tuple(float(x) for x in [*inertial.ravel(), *at_joint.ravel()])
    )


def links(model: Any) -> list[int]:
    """The joint that moves each body, -1 where none does."""
    joint_of = [-1] * model.nbody
    for body in range(1, model.nbody):
        count = model.body_jntnum[body]
        joint_of[body] = (
            model.body_jntadr[body] + count - 1 if count else joint_of[model.body_parentid[body]]
        )
    return joint_of


def joint_axes(data: Any) -> Array:
    """Each link's axes in the world as columns, the last along its joint, `(joints, 3, 3)`."""
    return np.stack([_axes(z) for z in data.xaxis])


def _axes(z: Array) -> Array:
    """Three axes, the last along `z`, as columns."""
    aside = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = aside - z * (z @ aside)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def seen_from(model: Any, data: Any, body: int, axes: Array, origin: Array) -> Array:
    """A body's ten inertial numbers about an origin and along axes, both in the world."""
    mass = float(model.body_mass[body])
    turn = axes.T @ data.ximat[body].reshape(3, 3)
    at = axes.T @ (data.xipos[body] - origin)
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T + mass * (
        at @ at * np.eye(3) - np.outer(at, at)
    )
    x, y, z = inertia
    return np.array([mass, *(mass * at), x[0], y[1], z[2], x[1], x[2], y[2]])


def _actuated(engine: Any, model: Any, joint: int, name: str, row: Array) -> tuple[float, float]:
    """Add what the joint's actuator does to its numbers; its constant force and its limit."""
    offset, limit = 0.0, NO_LIMIT
    # alike for hinges and slides
    through = int(engine.mjtTrn.mjTRN_JOINT), int(engine.mjtTrn.mjTRN_JOINTINPARENT)
    acting = [
        i
        for i in range(model.nu)
        if model.actuator_trntype[i] in through and model.actuator_trnid[i, 0] == joint
    ]
    if len(acting) > 1:
        raise BadPlant(
            f"joint {name} has {len(acting)} actuators; one can be told from the log",
            field="nominal.mjcf",
        )
    for i in acting:
        plain = (model.actuator_gaintype[i], model.actuator_dyntype[i]) == (
            int(engine.mjtGain.mjGAIN_FIXED),
            int(engine.mjtDyn.mjDYN_NONE),
        )
        affine = model.actuator_biastype[i] in (
            int(engine.mjtBias.mjBIAS_NONE),
            int(engine.mjtBias.mjBIAS_AFFINE),
        )
        if not (plain and affine):
            raise BadPlant(
                (
                    f"the actuator of joint {name} is neither a motor nor a servo of position or "
                    "velocity"
                ),
                field="nominal.mjcf",
                hint=(
                    "Describe it by <motor>, <position> or <velocity>; what else it does is "
                    "what a diagnosis finds."
                ),
            )
        gear = float(model.actuator_gear[i, 0])
        bias = (
            model.actuator_biasprm[i]
            if model.actuator_biastype[i] == int(engine.mjtBias.mjBIAS_AFFINE)
            else np.zeros(3)
        )
        row[2] += gear * float(model.actuator_gainprm[i, 0])
        row[3] += -gear * gear * float(bias[1])
        row[1] += -gear * gear * float(bias[2])
        offset = gear * float(bias[0])
        if model.actuator_forcelimited[i]:
            limit = abs(gear) * _largest(model.actuator_forcerange[i], name)
        if model.jnt_actfrclimited[joint]:
            limit = min(limit, _largest(model.jnt_actfrcrange[joint], name))
    return offset, limit


def _largest(bounds: Array, name: str) -> float:
    """The force up to which an actuator goes both ways. Raises BadPlant where they differ."""
    low, high = float(bounds[0]), float(bounds[1])
    if low != -high:
        raise BadPlant(
            f"the force range of joint {name}'s actuator is not the same both ways",
            field="nominal.mjcf",
        )
    return high


def _left_out(model: Any) -> list[str]:
    """What the file says that a rollout does not do."""
    lines = []
    if bool(((model.geom_contype > 0) | (model.geom_conaffinity > 0)).any()):
        lines.append("contact")
    if bool(model.jnt_limited.any()):
        lines.append("joint limits")
    if bool(np.any(model.body_gravcomp)):
        lines.append("gravity compensation")
    if model.opt.density > 0.0 or model.opt.viscosity > 0.0:
        lines.append("fluid forces")
    if np.any(model.jnt_stiffnesspoly) or np.any(model.dof_dampingpoly):
        lines.append("springs and dampers of higher order")
    if model.neq:
        lines.append("equality constraints")
    if model.ntendon:
        lines.append("tendons")
    return lines
