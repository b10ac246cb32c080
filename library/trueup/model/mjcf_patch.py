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
PARTLY = ("hard_stop", "stribeck_friction")


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
    for term in model.hypothesis.effects:
        effect, at = kind(term).name, given.joints[joint(term)]
        values = {name: model.values[row] for name, row in model.plant.block.rows_of(term).items()}
        if not _native(
            effect, values, float(dynamics.form.sizes[joint(term)]), given, joint(term), corrected
        ):
            left.append(Left(effect, at, effects()[effect].in_mjcf))
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
    driven = bool(into[at, "actuator", "gain"])

    def add(element: str, attribute: str, by: float) -> None:
        into[at, element, attribute] = float(into[at, element, attribute]) + by  # type: ignore[arg-type]

    if effect in ("coulomb_friction", "stribeck_friction"):
        add("joint", "frictionloss", size * values["level"])
    elif effect == "quadratic_drag":
        into[at, "joint", "damping |v|"] = size * values["coefficient"]
    elif effect == "cubic_stiffness" and tree.constants[j, REST] == 0.0:
        into[at, "joint", "stiffness q^2"] = size * values["coefficient"]
    elif effect == "constant_force" and driven:
        add("actuator", "offset", size * values["level"])
    elif effect == "saturation" and driven:
        _limit(values["limit"], at, into)
    elif effect == "actuator_lag" and driven:
        into[at, "actuator", "lag"] = values["time_constant"]
    elif effect == "actuator_delay" and driven:
        into[at, "actuator", "delay"] = values["delay"]
    elif effect == "sensor_delay":
        into[at, "sensor", "delay"] = values["delay"]
    elif effect == "hard_stop":
        ends = [values["centre"] - values["limit"], values["centre"] + values["limit"]]
        into[at, "tendon", "low high stiffness"] = [*ends, size * values["stiffness"]]
    else:
        return False
    return effect not in PARTLY
