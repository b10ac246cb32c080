"""Nominal form: what the field `nominal` of plant.json says, as dynamics with their parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trueup.errors import BadPlant
from trueup.model.dynamics import CompiledFamily, CompiledTree, Dynamics
from trueup.model.family import families
from trueup.model.fields import Reader
from trueup.model.mjcf import with_tree
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.simulator.simulator import Simulator, digest_of_file, step_at_hand
from trueup.model.tree import ZERO, Tree
from trueup.model.tree_regressors import mass_matrix


def resolved(document: Any, folder: Path) -> Any:
    """A plant's document with what the files that it names hold: the numbers of an MJCF in a
    folder, the SHA-256 of a simulator that was loaded. Raises BadPlant, NotInstalled."""
    document = with_tree(document, folder)
    nominal = document.get("nominal") if isinstance(document, dict) else None
    if not isinstance(nominal, dict) or "simulator" not in nominal or "sha256" in nominal:
        return document
    sha256 = digest_of_file(Reader.of(nominal, "nominal").text("simulator"))
    return {**document, "nominal": {**nominal, **({"sha256": sha256} if sha256 else {})}}


def read_nominal(nominal: Reader) -> tuple[Dynamics, tuple[float, ...]]:
    """The dynamics of a nominal model and its parameters: a family of one joint, a robot's tree, or
    a simulator of the user's own, of any joints. Raises BadPlant, BadSimulator."""
    if "mjcf" in nominal.value:
        return _robot(nominal)
    return _simulator(nominal) if "simulator" in nominal.value else _family(nominal)


def _simulator(nominal: Reader) -> tuple[Dynamics, tuple[float, ...]]:
    name, sha256 = nominal.text("simulator"), nominal.text("sha256", "")
    given = nominal.child("parameters")
    # in the order of their names, as canonical JSON has them
    parameters = {key: given.number(key) for key in sorted(given.value)}
    begins = nominal.numbers("begins") if "begins" in nominal.value else []
    names = tuple(nominal.names("joints")) if "joints" in nominal.value else (None,)
    nominal.no_more(
        "simulator", "sha256", "parameters", "begins", "joints", "timestep_s", "integrator"
    )
    step, timestep_s = step_at_hand(sha256, name), nominal.number("timestep_s", above=0.0)
    declared = Simulator(name, step, parameters, timestep_s, tuple(begins), sha256, names)
    dynamics = SimulatedDynamics(declared.checked())
    dynamics.sizes(tuple(parameters.values()))  # raises where a force is taken and not used
    return dynamics, tuple(parameters.values())


def _family(nominal: Reader) -> tuple[Dynamics, tuple[float, ...]]:
    family = families()[nominal.choice("family", list(families()))]
    given = nominal.child("parameters")
    names = [p.name for p in family.params]
    given.no_more(*names)
    nominal.no_more("family", "parameters", "timestep_s", "integrator")
    return CompiledFamily(family), tuple(given.number(name) for name in names)


def _robot(nominal: Reader) -> tuple[Dynamics, tuple[float, ...]]:
    nominal.text("mjcf")
    if "tree" not in nominal.value:
        raise BadPlant(
            "the model's numbers are missing: an MJCF is read where its files are",
            field="nominal.tree",
            hint=(
                "Hand in the case folder: `trueup plant register FOLDER` and `trueup "
                "diagnose FOLDER` read the model beside plant.json."
            ),
        )
    tree = Tree.read(nominal.child("tree"))
    nominal.text("sha256", "")
    left_out = nominal.value.get("left_out", [])
    if not isinstance(left_out, list) or not all(isinstance(x, str) for x in left_out):
        raise BadPlant("nominal.left_out must be a list of words", field="nominal.left_out")
    nominal.no_more("mjcf", "timestep_s", "integrator", "tree", "sha256", "left_out")
    masses = mass_matrix(tree, tree.constants[None, :, ZERO])[0]
    if not np.isfinite(masses).all() or np.linalg.eigvalsh(masses)[0] <= 0.0:
        raise BadPlant(
            "the model's masses move no joint: its mass matrix is not positive",
            field="nominal.tree",
        )
    return CompiledTree(tree), tree.parameters
