"""MJCF drive: the elements that give a joint what its correction changes: its own attributes, its
actuator, a motor of its own behind a spring, passive forces, sensors and stops.

    joint      damping, stiffness, armature, friction loss
    general    an actuator with gain, servo, offset, limits, lag and delay
    dcmotor    an actuator whose command cannot change faster than so much; without inputs, a
               passive force: cogging, and friction by bristles
    body       a motor's inertia on a joint of its own, beside the link's, and a tendon with
               stiffness and damping between them
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from trueup.canonical import Json
from trueup.model.mjcf_patch import BRISTLES, COGGING, Patch
from trueup.model.xml_tags import Tag, spaced, start_tag

KEPT = ("name", "group", "user")  # attributes of an actuator that say nothing of its force
PLACED = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler")  # attributes of a body's frame
HARD = "0.9999 0.9999"  # impedance of a constraint that hardly gives
# times the samples that a delay's history needs: whoever simulates it on finer steps needs more
SPARE = 8
NEXT_TO_NOTHING = 1e-9  # kg, kg m^2: of a body whose inertia is its joint's armature
# of the force at rest: what bristles still hold in fast motion, for MuJoCo divides by it
LEAST_FORCE = 1e-6
UNIT = {"motorconst": "1", "resistance": "1"}  # what a commanded torque does not depend on
PASSIVE = {"input": "none", "motorconst": "0", "resistance": "1"}


def actuator_of(model: Any, joint: int) -> int:
    """The joint's actuator, -1 where it has none."""
    return next((i for i in range(model.nu) if model.actuator_trnid[i, 0] == joint), -1)


def velocity_gain(model: Any, actuator: int) -> float:
    """What of a joint's damping its actuator gives."""
    return (
        -(float(model.actuator_gear[actuator, 0]) ** 2) * float(model.actuator_biasprm[actuator, 2])
        if actuator >= 0
        else 0.0
    )


def motor_of(joint: str) -> str:
    """The name of a joint's motor, which has a joint and a body of this name."""
    return f"motor of {joint}"


@dataclass(frozen=True)
class Drive:
    """A joint of a compiled model, by its number, and what a patch changes there."""

    engine: Any
    model: Any
    number: int
    patch: Patch

    @cached_property
    def name(self) -> str:
        """The joint's name."""
        return str(self.model.joint(self.number).name)

    def _given(self, element: str) -> dict[str, Json]:
        return self.patch.of(self.name, element)

    @cached_property
    def actuator(self) -> int:
        """The joint's actuator, -1 where it has none."""
        return actuator_of(self.model, self.number)

    @cached_property
    def has_motor(self) -> bool:
        """Whether the motor gets an inertia of its own."""
        return bool(self._given("motor"))

    @cached_property
    def acts(self) -> bool:
        """Whether the actuator changes."""
        return bool(self._given("actuator")) or self.has_motor

    @cached_property
    def _damping_by_actuator(self) -> float:
        """What of the joint's damping its actuator gives: nothing, where it sits at the motor."""
        return 0.0 if self.has_motor else velocity_gain(self.model, self.actuator)

    @cached_property
    def joint(self) -> dict[str, str]:
        """Attributes of the joint's tag."""
        model, j, given = self.model, self.number, self._given("joint")
        plain = [name for name in ("armature", "frictionloss") if name in given]
        written: dict[str, str] = {name: spaced(given[name]) for name in plain}
        if "frictionloss" in given:  # as hard as MuJoCo has it: it holds, and does not creep
            written |= {
                "solreffriction": spaced(2.0 * model.opt.timestep, 1.0),
                "solimpfriction": HARD,
            }
        if self.has_motor:
            own = float(np.ravel(model.dof_damping[j])[0])
            given = {"damping": own + velocity_gain(model, self.actuator), **given}
        for name, behind, linear, higher in (
            ("damping", "damping |v|", model.dof_damping[j], model.dof_dampingpoly[j]),
            ("stiffness", "stiffness q^2", model.jnt_stiffness[j], model.jnt_stiffnesspoly[j]),
        ):
            if name not in given and behind not in given:
                continue
            first = float(np.ravel(linear)[0])
            if name in given:
                first = float(given[name])  # type: ignore[arg-type]
                if name == "damping":
                    first = max(first - self._damping_by_actuator, 0.0)
            more = list(higher)
            if behind in given:
                more[0 if name == "damping" else 1] += float(given[behind])  # type: ignore[arg-type]
            written[name] = spaced(first, *more) if any(more) else spaced(first)
        return written

    def element(self, at: Tag | None) -> str:
        """The joint's actuator as an element, in the place of the tag `at`, which it has so far."""
        acts = self._given("actuator")
        limited = self.actuator >= 0 and self.model.actuator_forcelimited[self.actuator]
        geared = at is not None and at.name == "motor" and set(acts) == {"gain"}
        if at and geared and not self.has_motor and not limited:
            return start_tag("motor", {**at.attributes, "gear": spaced(acts["gain"])}, True)
        named = {k: v for k, v in at.attributes.items() if k in KEPT} if at else {"name": self.name}
        if "rate" in acts:
            return start_tag("dcmotor", {**named, **self._dcmotor(acts["rate"])}, True)
        return start_tag("general", {**named, **self._general()}, True)

    @cached_property
    def _forces(self) -> tuple[float, float, float, float]:
        """Gain, servo, offset and velocity gain of the actuator."""
        model, actuator, given = self.model, self.actuator, self._given("actuator")
        gain, servo, offset = 1.0, 0.0, 0.0
        if actuator >= 0:
            gear = float(model.actuator_gear[actuator, 0])
            affine = int(self.engine.mjtBias.mjBIAS_AFFINE)
            has_bias = model.actuator_biastype[actuator] == affine
            bias = model.actuator_biasprm[actuator] if has_bias else np.zeros(3)
            gain = gear * float(model.actuator_gainprm[actuator, 0])
            servo, offset = -(gear**2) * float(bias[1]), gear * float(bias[0])
        velocity, passive = self._damping_by_actuator, self._given("joint")
        if "damping" in passive:
            velocity = min(velocity, max(float(passive["damping"]), 0.0))  # type: ignore[arg-type]
        standing = (("gain", gain), ("servo", servo), ("offset", offset))
        gain, servo, offset = (float(given.get(k, x)) for k, x in standing)  # type: ignore[arg-type]
        return gain, servo, offset, velocity

    @cached_property
    def _limits(self) -> dict[str, tuple[float, float]]:
        """Ranges of the command and of the force at the joint."""
        model, actuator, given = self.model, self.actuator, self._given("actuator")
        limits: dict[str, tuple[float, float]] = {}
        if actuator >= 0:
            gear = abs(float(model.actuator_gear[actuator, 0]))
            if model.actuator_ctrllimited[actuator]:
                limits["ctrl"] = tuple(model.actuator_ctrlrange[actuator])
            if model.actuator_forcelimited[actuator]:
                limits["force"] = tuple(gear * model.actuator_forcerange[actuator])
        for what in ("ctrl", "force"):
            if f"{what}range" in given:
                limits[what] = tuple(given[f"{what}range"])  # type: ignore[arg-type, assignment]
        return limits

    @cached_property
    def _driven(self) -> str:
        """The joint that the actuator drives."""
        return motor_of(self.name) if self.has_motor else self.name

    def _general(self) -> dict[str, str]:
        """Attributes of a general actuator that does what the joint's own does, and what
        changes."""
        given = self._given("actuator")
        gain, servo, offset, velocity = self._forces
        written = {
            "joint": self._driven,
            "gear": "1",
            "gaintype": "fixed",
            "gainprm": spaced(gain),
            "biastype": "affine",
            "biasprm": spaced(offset, -servo, -velocity),
        }
        for what in ("ctrl", "force"):
            limit = self._limits.get(what)
            written[f"{what}limited"] = "true" if limit else "false"
            if limit:
                written[f"{what}range"] = spaced(*limit)
        written |= (
            {"dyntype": "filterexact", "dynprm": spaced(given["lag"]), "actlimited": "false"}
            if "lag" in given
            else {"dyntype": "none"}
        )
        return {**written, **self._delay(given)}

    def _dcmotor(self, rate: Json) -> dict[str, str]:
        """Attributes of a motor whose controller changes its torque, or its goal, no faster."""
        gain, servo, _, velocity = self._forces
        gear = 1.0 if servo else gain  # a torque is geared, a goal is not
        limits = {"ctrllimited": "false"}
        if "ctrl" in self._limits:
            limits = {"ctrllimited": "true", "ctrlrange": spaced(*self._limits["ctrl"])}
        if "force" in self._limits:
            limits["saturation"] = spaced(self._limits["force"][1] / abs(gear), 0.0, 0.0)
        controller = spaced(servo, 0.0, velocity / gear**2, rate, 0.0, 0.0)
        return {
            "joint": self._driven,
            **UNIT,
            "gear": spaced(gear),
            "input": "pos" if servo else "ff",
            "controller": controller,
            **limits,
            **self._delay(self._given("actuator")),
        }

    def motor(self, holder: Mapping[str, str]) -> str:
        """A body beside the link's, in its frame, whose joint has the motor's inertia."""
        model, j = self.model, self.number
        (numbers,) = self._given("motor").values()
        inertia, _, _ = numbers  # type: ignore[misc, str-unpack]
        slides = model.jnt_type[j] == self.engine.mjtJoint.mjJNT_SLIDE
        name, nothing = motor_of(self.name), spaced(*[NEXT_TO_NOTHING] * 3)
        joint = {
            "name": name,
            "type": "slide" if slides else "hinge",
            "axis": spaced(*model.jnt_axis[j]),
            "pos": spaced(*model.jnt_pos[j]),
            "armature": spaced(inertia),
            **dict.fromkeys(("damping", "frictionloss", "stiffness"), "0"),
            "limited": "false",
        }
        mass = {"pos": spaced(*model.jnt_pos[j]), "mass": spaced(NEXT_TO_NOTHING)}
        frame = {k: v for k, v in holder.items() if k in PLACED}
        return (
            "\n"
            + start_tag("body", {"name": name, **frame}, False)
            + start_tag("joint", joint, True)
            + start_tag("inertial", {**mass, "diaginertia": nothing}, True)
            + "</body>"
        )

    def sections(self) -> list[str]:
        """What the joint's correction adds to a file."""
        added = []
        late = self._given("sensor")
        if late:
            held = self._delay(late)
            sensors = [
                start_tag(
                    k, {"name": f"{self.name} {k} as logged", "joint": self.name, **held}, True
                )
                for k in ("jointpos", "jointvel")
            ]
            added.append(f"<sensor>{''.join(sensors)}</sensor>")
        for numbers in self._given("tendon").values():
            low, high, stiffness = numbers  # type: ignore[misc, str-unpack]
            stop = {"springlength": spaced(low, high), "stiffness": spaced(stiffness)}
            added.append(self._tendon({"name": f"stop of {self.name}", **stop}, {self.name: 1}))
        for numbers in self._given("motor").values():
            _, stiffness, damping = numbers  # type: ignore[misc, str-unpack]
            spring = {
                "name": f"transmission of {self.name}",
                "springlength": spaced(*[-self.model.qpos0[self.number]] * 2),
                "stiffness": spaced(stiffness),
                "damping": spaced(damping),
            }
            added.append(self._tendon(spring, {motor_of(self.name): 1, self.name: -1}))
        passive = [self._passive(what, n) for what, n in self._given("dcmotor").items()]
        return [*added, *([f"<actuator>{''.join(passive)}</actuator>"] if passive else [])]

    def _tendon(self, attributes: Mapping[str, str], of: Mapping[str, int]) -> str:
        """A fixed tendon whose length is a sum of joints' positions."""
        joints = [start_tag("joint", {"joint": j, "coef": str(c)}, True) for j, c in of.items()]
        whole = f"{start_tag('fixed', attributes, False)}{''.join(joints)}</fixed>"
        return f"<tendon>{whole}</tendon>"

    def _passive(self, what: str, numbers: Json) -> str:
        """A passive force of the joint: cogging, or friction by bristles."""
        given = [float(x) for x in numbers]  # type: ignore[arg-type, union-attr]
        if what == COGGING:  # a gear turns once a pitch, so that any pitch is one pole
            force, pitch, phase = given
            gear = 2.0 * np.pi / pitch
            kind = "cogging"
            how = {"gear": spaced(gear), "cogging": spaced(force / gear, 1.0, phase)}
        elif what == BRISTLES:
            stiffness, force, _ = given
            kind, how = "hysteresis", {"lugre": spaced(stiffness, 0.0, force, force, 1.0)}
        else:
            stiffness, force, speed = given
            kind = "friction near rest"
            how = {"lugre": spaced(stiffness, 0.0, LEAST_FORCE * force, force, speed)}
        name = f"{kind} of {self.name}"
        return start_tag("dcmotor", {"name": name, "joint": self.name, **PASSIVE, **how}, True)

    def _delay(self, given: Mapping[str, Json]) -> dict[str, str]:
        """A delay, and as many samples as it needs."""
        if "delay" not in given:
            return {}
        late = float(given["delay"])  # type: ignore[arg-type]
        samples = SPARE * (int(np.ceil(late / self.model.opt.timestep)) + 1)
        return {"delay": spaced(late), "nsample": str(samples)}
