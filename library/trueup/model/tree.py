"""Tree: a robot of rigid links as numbers: how its joints hang together, and the parameters of its
links and joints.

It is what is left of an MJCF once it has been compiled: nothing here reads XML, and nothing needs
MuJoCo.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.errors import BadPlant
from trueup.model.fields import Reader

Array = NDArray[np.float64]
NO_LIMIT = 1e30
MOST_JOINTS = 32  # of one robot
SWEEPS = 12  # over the joints that rub, where several do
# about the joint, along the link's axes
INERTIAL = "mass", "hx", "hy", "hz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"
AT_JOINT = ("armature", "damping", "gain", "servo", "stiffness", "frictionloss")
LINK, JOINT = len(INERTIAL), len(AT_JOINT)
ARMATURE, DAMPING, GAIN, SERVO, STIFFNESS, FRICTION = range(JOINT)
# parent, slide, frame (x, y, z axes, origin), zero, spring's rest, actuator's offset and limit,
# gravity
TREE = 21
PARENT, SLIDE, FRAME, ZERO, REST, OFFSET, LIMIT, GRAVITY = 0, 1, 2, 14, 15, 16, 17, 18


@dataclass(frozen=True)
class Tree:
    """Joints `(joints,)` in an order in which parents come first.

    `constants` `(joints, TREE)` is what the compiled dynamics read: parent (-1 for the base),
    whether it slides, its frame in its parent's, the position at which the frame is so [rad, m],
    the spring's rest, the actuator's constant force and its limit, gravity. `parameters` are ten
    inertial numbers of each link [kg, kg m, kg m^2], then six of each joint: armature, damping,
    gain, servo (the actuator's stiffness), stiffness, friction loss.
    """

    joints: tuple[str, ...]
    constants: Array
    parameters: tuple[float, ...]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters: `mass(link)`, `damping(joint)`; a link is named for its
        joint."""
        return tuple(f"{x}({j})" for j in self.joints for x in INERTIAL) + tuple(
            f"{x}({j})" for j in self.joints for x in AT_JOINT
        )

    @property
    def links(self) -> Array:
        """A copy of the inertial numbers by link, `(joints, LINK)`."""
        return np.array(self.parameters[: LINK * len(self.joints)]).reshape(-1, LINK)

    @property
    def at_joint(self) -> Array:
        """A copy of the other numbers by joint, `(joints, JOINT)`."""
        return np.array(self.parameters[LINK * len(self.joints) :]).reshape(-1, JOINT)

    def document(self) -> dict[str, Json]:
        """The tree as JSON, as `read` takes it."""
        return {
            "gravity": [float(x) for x in self.constants[0, GRAVITY:]],
            "joints": [
                {
                    "name": name,
                    "parent": self.joints[int(c[PARENT])] if c[PARENT] >= 0.0 else None,
                    "type": "slide" if c[SLIDE] else "hinge",
                    "frame": [float(x) for x in c[FRAME:ZERO]],
                    "zero": float(c[ZERO]),
                    "rest": float(c[REST]),
                    "offset": float(c[OFFSET]),
                    "limit": float(c[LIMIT]) if c[LIMIT] < NO_LIMIT else None,
                    "inertial": [float(x) for x in link],
                    **dict(zip(AT_JOINT, (float(x) for x in at), strict=True)),
                }
                for name, c, link, at in zip(
                    self.joints, self.constants, self.links, self.at_joint, strict=True
                )
            ],
        }

    @staticmethod
    def read(given: Reader) -> Tree:
        """Read the JSON again. Raises BadPlant with the field that breaks a rule."""
        gravity = given.numbers("gravity", 3)
        names: list[str] = []
        constants, links, rows = [], [], []
        for joint in given.children("joints"):
            parent = joint.text("parent", "") if joint.value.get("parent") is not None else ""
            if parent and parent not in names:
                raise BadPlant(
                    f"the parent {parent} does not come before its joint", field=joint.at("parent")
                )
            slides = joint.choice("type", ["hinge", "slide"]) == "slide"
            limit = (
                joint.number("limit", above=0.0)
                if joint.value.get("limit") is not None
                else NO_LIMIT
            )
            at = [names.index(parent) if parent else -1, slides, *joint.numbers("frame", 12)]
            constants.append(
                [*at, *(joint.number(k) for k in ("zero", "rest", "offset")), limit, *gravity]
            )
            links.append(joint.numbers("inertial", LINK))
            rows.append([joint.number(name) for name in AT_JOINT])
            names.append(joint.text("name"))
            joint.no_more(
                "name",
                "parent",
                "type",
                "frame",
                "zero",
                "rest",
                "offset",
                "limit",
                "inertial",
                *AT_JOINT,
            )
        given.no_more("gravity", "joints")
        if len(set(names)) < len(names):
            raise BadPlant("two joints have one name", field=given.at("joints"))
        if len(names) > MOST_JOINTS:
            raise BadPlant(
                f"the model has {len(names)} joints; {MOST_JOINTS} are the most",
                field=given.at("joints"),
            )
        table = np.array(constants, float).reshape(-1, TREE)
        axes = table[:, FRAME : FRAME + 9].reshape(-1, 3, 3)
        if (
            not np.allclose(axes @ axes.transpose(0, 2, 1), np.eye(3), atol=1e-6)
            or (np.linalg.det(axes) < 0.0).any()
        ):
            raise BadPlant("a joint's frame is no rotation", field=given.at("joints"))
        if min(min(row[ARMATURE], row[DAMPING], row[FRICTION]) for row in rows) < 0.0:
            raise BadPlant(
                "an armature, a damping or a friction loss is negative", field=given.at("joints")
            )
        return Tree(tuple(names), table, tuple(float(x) for part in (*links, *rows) for x in part))
