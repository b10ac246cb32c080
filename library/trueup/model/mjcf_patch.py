"""MJCF patch: what of a corrected robot MuJoCo's own elements express, and what they cannot.

It is made of numbers alone, so that a service that has neither MuJoCo nor the file can tell it;
`trueup.model.mjcf_writer` writes it into the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import singledispatch

import numpy as np

from trueup.canonical import Json
from trueup.model.block import joint, kind
from trueup.model.corrected import Corrected
from trueup.model.dynamics import CompiledTree, Dynamics
from trueup.model.effect import effects
from trueup.model.feasible import feasible
from trueup.model.tree import AT_JOINT, INERTIAL, JOINT, LINK, OFFSET, REST, Tree

SAME = 1e-9  # of a number's size: not a change
EXACT = 1e-5  # of the forces: links that move the same way
ELEMENTS = dict(
    zip(AT_JOINT, ("joint", "joint", "actuator", "actuator", "joint", "joint"), strict=True)
)
COGGING, BRISTLES = "force pitch phase", "stiffness force distance"
STRIBECK = "stiffness force speed"
DAHL = (
    0.999  # shape of a hysteresis, beyond which its law is P. Dahl's, as MuJoCo's bristles have it
)
BRISTLE_S = 0.002  # bristles give way in so much time at the curve's own speed: a usual step


@dataclass(frozen=True, slots=True)
class Change:
    """One attribute of a joint, its actuator, its link, or its sensor, as numbers in MuJoCo's
    units."""

    joint: str
    element: str
    attribute: str
    nominal: Json
    corrected: Json

    def document(self) -> dict[str, Json]:
        """The change as JSON."""
        return {
            "joint": self.joint,
            "element": self.element,
            "attribute": self.attribute,
            "nominal": self.nominal,
            "corrected": self.corrected,
        }


@dataclass(frozen=True, slots=True)
class Left:
    """What MJCF has no element for: an effect at a joint or "" for a number, and what a person can
    write instead."""

    effect: str
    joint: str
    instead: str

    def __str__(self) -> str:
        return (
            f"{' at '.join(x for x in (self.effect, self.joint) if x) or 'masses'}: {self.instead}"
        )

    def document(self) -> dict[str, Json]:
        """What is not expressed, as JSON."""
        return {"effect": self.effect, "joint": self.joint, "instead": self.instead}


@dataclass(frozen=True, slots=True)
class Patch:
    """Changes to a model's file, and what it cannot express."""

    changes: tuple[Change, ...]
    left: tuple[Left, ...]

    def document(self) -> dict[str, Json]:
        """The patch as JSON, a field of the report."""
        return {
            "changes": [c.document() for c in self.changes],
            "not_expressed": [x.document() for x in self.left],
        }

    def of(self, joint: str, element: str) -> dict[str, Json]:
        """The corrected attributes of one element, by name."""
        return {
            c.attribute: c.corrected
            for c in self.changes
            if (c.joint, c.element) == (joint, element)
        }


def patch(model: Corrected) -> Patch:
    """What a corrected robot differs in from its nominal MJCF. Of a plant that is none, nothing."""
    return _patch(model.plant.dynamics, model)


@singledispatch
def _patch(_: Dynamics, model: Corrected) -> Patch:
    return Patch((), ())


@_patch.register
def _patch_of_tree(dynamics: CompiledTree, model: Corrected) -> Patch:
    given, count = dynamics.tree, len(dynamics.tree.parameters)
    links = slice(0, LINK * len(given.joints))
    fitted = replace(given, parameters=model.values[:count])
    changes, left = [], []
    if not np.allclose(fitted.parameters[links], given.parameters[links], rtol=SAME, atol=0.0):
        fitted, off = feasible(fitted)
        if off > EXACT:
            why = (
                "no bodies have the masses that were fitted; those written are the nearest, "
                f"their forces off by {100.0 * off:.2g} %"
            )
            left.append(Left("", "", why))
    nominal, corrected = _numbers(given), _numbers(fitted)
    instead = {name: effect.in_mjcf for name, effect in effects().items()}
    for term in model.hypothesis.effects:
        effect, at = kind(term).name, given.joints[joint(term)]
        values = {name: model.values[row] for name, row in model.plant.block.rows_of(term).items()}
        if not _native(
            effect, values, float(dynamics.form.sizes[joint(term)]), given, joint(term), corrected
        ):
            left.append(Left(effect, at, instead[effect]))
    for at in given.joints:
        if (at, "actuator", "rate") in corrected and not _limits_rate(at, corrected):
            del corrected[at, "actuator", "rate"]
            left.append(Left("rate_limit", at, instead["rate_limit"]))
    for key, value in corrected.items():
        before = nominal.get(key)
        if before is None or not np.allclose(
            np.array(value), np.array(before), rtol=SAME, atol=1e-12
        ):
            changes.append(Change(*key, before, value))
    return Patch(tuple(changes), tuple(left))


Numbers = dict[tuple[str, str, str], Json]  # by joint, element, attribute


def _numbers(tree: Tree) -> Numbers:
    """A robot's numbers as MJCF has them."""
    links = np.array(tree.parameters[: LINK * len(tree.joints)]).reshape(-1, LINK)
    rows = np.array(tree.parameters[links.size :]).reshape(-1, JOINT)
    corrected_numbers: Numbers = {}
    for name, link, row, constants in zip(tree.joints, links, rows, tree.constants, strict=True):
        corrected_numbers |= {
            (name, ELEMENTS[n], n): float(x) for n, x in zip(AT_JOINT, row, strict=True)
        }
        corrected_numbers[name, "actuator", "offset"] = float(constants[OFFSET])
        corrected_numbers[name, "link", " ".join(INERTIAL)] = [float(x) for x in link]
    return corrected_numbers


def _limit(limit: float, at: str, into: Numbers) -> None:
    """A motor's command ends at a limit, and so does a servo's force, where its error is that
    large."""
    if into[at, "actuator", "servo"]:
        force = abs(float(into[at, "actuator", "gain"])) * limit  # type: ignore[arg-type]
        into[at, "actuator", "forcerange"] = [-force, force]
    else:
        into[at, "actuator", "ctrlrange"] = [-limit, limit]


def _native(
    effect: str, values: Mapping[str, float], size: float, tree: Tree, j: int, into: Numbers
) -> bool:
    """Write what MJCF has of an effect into the numbers; whether that is all of it. `size` is the
    inertia that forces were divided by."""
    at = tree.joints[j]
    forces = {name: size * x for name, x in values.items()}
    if effect == "cubic_stiffness" and tree.constants[j, REST] != 0.0:
        return False
    if into[at, "actuator", "gain"] and _at_actuator(effect, values, size, at, into):
        return True
    return _at_joint(effect, values, forces, at, into)


def _at_actuator(
    effect: str, values: Mapping[str, float], size: float, at: str, into: Numbers
) -> bool:
    """Write an effect that the joint's actuator has; whether it has it."""
    if effect == "elastic_transmission":
        return _two_masses(values, size, at, into)
    if effect == "constant_force":
        _add(into, at, "actuator", "offset", size * values["level"])
    elif effect == "saturation":
        _limit(values["limit"], at, into)
    elif effect == "rate_limit":
        into[at, "actuator", "rate"] = values["rate"]
    elif effect == "actuator_lag":
        into[at, "actuator", "lag"] = values["time_constant"]
    elif effect == "actuator_delay":
        into[at, "actuator", "delay"] = values["delay"]
    else:
        return False
    return True


def _at_joint(
    effect: str, values: Mapping[str, float], forces: Mapping[str, float], at: str, into: Numbers
) -> bool:
    """Write an effect that acts at the joint, driven or not; whether that is all of it. `forces`
    are its values as forces."""
    if effect == "coulomb_friction":
        _add(into, at, "joint", "frictionloss", forces["level"])
    elif effect == "stribeck_friction":
        _add(into, at, "joint", "frictionloss", forces["level"])
        extra, speed = forces["extra"], values["speed"]
        into[at, "dcmotor", STRIBECK] = [extra / (speed * BRISTLE_S), extra, speed]
        return False  # bristles give way before they slide, and their curve is Gaussian
    elif effect == "quadratic_drag":
        into[at, "joint", "damping |v|"] = forces["coefficient"]
    elif effect == "cubic_stiffness":
        into[at, "joint", "stiffness q^2"] = forces["coefficient"]
    elif effect == "cogging":
        largest = float(np.hypot(forces["sine"], forces["cosine"]))
        phase = float(np.arctan2(values["cosine"], values["sine"]))
        into[at, "dcmotor", COGGING] = [largest, values["pitch"], phase]
    elif effect == "hysteresis" and values["shape"] >= DAHL and values["sharpness"] <= 1.0 - DAHL:
        level, distance = forces["level"], values["distance"]
        into[at, "dcmotor", BRISTLES] = [level / distance, level, distance]
    elif effect == "sensor_delay":
        into[at, "sensor", "delay"] = values["delay"]
    elif effect == "hard_stop":
        ends = [values["centre"] - values["limit"], values["centre"] + values["limit"]]
        into[at, "tendon", "low high stiffness"] = [*ends, forces["stiffness"]]
        return False
    else:
        return False
    return True


def _add(into: Numbers, at: str, element: str, attribute: str, by: float) -> None:
    into[at, element, attribute] = float(into[at, element, attribute]) + by  # type: ignore[arg-type]


def _two_masses(values: Mapping[str, float], size: float, at: str, into: Numbers) -> bool:
    """Give the motor a share of the joint's armature and a spring to the joint; whether the
    armature has so much, and no servo asks where the joint is."""
    inertia = size * values["share"]
    armature = float(into[at, "joint", "armature"])  # type: ignore[arg-type]
    if inertia > armature or into[at, "actuator", "servo"]:
        return False
    into[at, "joint", "armature"] = armature - inertia
    swing = 2.0 * np.pi / values["period"]
    both = size * values["share"] * (1.0 - values["share"])
    spring = [inertia, both * swing**2, 2.0 * both * swing * values["ratio"]]
    into[at, "motor", "inertia stiffness damping"] = [float(x) for x in spring]
    return True


def _limits_rate(at: str, numbers: Numbers) -> bool:
    """Whether a dcmotor's limit of its command's rate acts as the effect does: without a lag and a
    constant force, which it does not have, and at a servo that asks for its goal alone."""
    gain, servo, offset = (float(numbers[at, "actuator", x]) for x in ("gain", "servo", "offset"))  # type: ignore[arg-type]
    asks = servo == 0.0 or bool(np.isclose(gain, servo))
    return asks and offset == 0.0 and (at, "actuator", "lag") not in numbers
