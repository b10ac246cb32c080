"""Explain: estimates with intervals, and each effect's share of the gap."""

from __future__ import annotations

from collections.abc import Mapping
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.correlations import correlations
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.intervals import Minima, covariance, intervals
from trueup.diagnose.model_selection import Choice
from trueup.diagnose.search import Search
from trueup.diagnose.tuning import DATA_QUALITY
from trueup.episode.layout import Field
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.fit.rollout_fit import TWO_SIDED, RolloutFit
from trueup.model.block import joint, kind
from trueup.model.corrected import Corrected
from trueup.model.dynamics import CompiledTree, Dynamics
from trueup.model.effect import Effect, Number, Scale, effects, equation_in
from trueup.model.family import families
from trueup.model.plant import Plant
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.tree import AT_JOINT, INERTIAL, SLIDE

Array = NDArray[np.float64]
FORCES = (Scale.ACCELERATION, Scale.DRAG, Scale.CUBIC, Scale.STIFFNESS, Scale.DAMPING)

# what is not said by its name
CALLED = {
    **{f"h{axis}": f"first moment along {axis}" for axis in "xyz"},
    **{f"I{axis}{axis}": f"inertia about {axis}" for axis in "xyz"},
    **{f"I{axes}": f"product of inertia {axes}" for axes in ("xy", "xz", "yz")},
    "servo": "servo stiffness",
}


def unit(scale: Scale, plant: Plant, joint: int = 0) -> str:
    """A scale in the declared units of a joint: a family's forces are accelerations, a tree's are
    what its actuators give."""
    q = next(
        (
            c.unit
            for c in plant.layout.observations
            if plant.joint_of(c) == joint and c.field is Field.POSITION
        ),
        "",
    )
    command = int(plant.command_columns[joint])
    u = (plant.layout.commands[command].unit if command >= 0 else "") or "1"
    q, forces = _force_units(plant.dynamics, joint, q)
    return {
        **dict(zip(FORCES, forces, strict=True)),
        Scale.VELOCITY: f"{q}/s",
        Scale.POSITION: q,
        Scale.COMMAND: u,
        Scale.DRIVE: u,
        Scale.RATE: f"{u}/s",
        Scale.TIME: "s",
        Scale.ONE: "1",
        Scale.DRIFT: f"{q}/s",
    }[scale]


@singledispatch
def _force_units(_: Dynamics, joint: int, q: str) -> tuple[str, list[str]]:
    """The unit of a joint's position, and those of FORCES."""
    q = q or "1"
    return q, [f"{q}/s^2", f"1/{q}", f"1/({q}^2 s^2)", "1/s^2", "1/s"]


@_force_units.register
def _of_tree(dynamics: CompiledTree, joint: int, q: str) -> tuple[str, list[str]]:
    slides = bool(dynamics.tree.constants[joint, SLIDE])
    q, force = q or ("m" if slides else "rad"), "N" if slides else "N·m"
    return q, [force, f"{force} s^2/{q}^2", f"{force}/{q}^3", f"{force}/{q}", f"{force} s/{q}"]


@_force_units.register
def _of_simulator(dynamics: SimulatedDynamics, joint: int, q: str) -> tuple[str, list[str]]:
    """A simulator's forces are in its own unit, which for a joint in rad or m is taken to be SI."""
    force = {"m": "N", "rad": "N·m"}.get(q, "force")
    q = q or "1"
    return q, [force, f"{force} s^2/{q}^2", f"{force}/{q}^3", f"{force}/{q}", f"{force} s/{q}"]


def in_units(scale: Scale, plant: Plant, joint: int) -> float:
    """How many of the declared units one of the fit's own is."""
    return float(plant.form.sizes[joint]) if scale in FORCES else 1.0


def estimates(
    minima: Minima,
    fitter: Fitter,
    plant: Plant,
    share: Mapping[str, float],
) -> list[Json]:
    """Effects with estimates, units, intervals and shares, of the best of some minima."""
    fit, spans = minima.best, intervals(minima)
    entries: list[Json] = []
    for term in fit.hypothesis.effects:
        values: dict[str, Json] = {}
        for number in kind(term).params:
            if (term, number.name) not in spans:
                continue  # the log did not ask for it
            value, factor = (
                fit.parameters(term)[number.name],
                in_units(number.scale, plant, joint(term)),
            )
            low, high = _inside(spans[term, number.name], number, fitter.unit(term, number.scale))
            measure = unit(number.scale, plant, joint(term))
            values[number.name] = {
                "value": factor * value,
                "unit": measure,
                "ci95": [factor * low, factor * high],
                "label": number.label,
            }
        entries.append(_entry(kind(term), values, share.get(term, 0.0), plant, joint(term)))
    return entries


def counted(quality: DataQuality, plant: Plant, samples: int) -> list[Json]:
    """Effects that are counted in the samples themselves: held frames and coarse lattices."""
    entries: list[Json] = []
    for at in range(len(plant.joints)):
        part = float(quality.held[at])
        if part > DATA_QUALITY.held_frames:
            error = TWO_SIDED * float(np.sqrt(part * (1.0 - part) / samples))
            value: Json = {
                "value": part,
                "unit": "1",
                "ci95": [max(part - error, 0.0), part + error],
                "label": effects()["dropped_frames"].params[0].label,
            }
            entries.append(_entry(effects()["dropped_frames"], {"fraction": value}, 0.0, plant, at))
        steps: dict[str, Json] = {}
        for n, step, coarse in zip(
            effects()["sensor_quantization"].params, *quality.lattices(at), strict=True
        ):
            if coarse:
                steps[n.name] = {
                    "value": float(step),
                    "unit": unit(n.scale, plant, at),
                    "ci95": [float(step), float(step)],
                    "label": n.label,
                }
        if steps:
            entries.append(_entry(effects()["sensor_quantization"], steps, 0.0, plant, at))
    return entries


def _entry(
    effect: type[Effect], values: dict[str, Json], share: float, plant: Plant, at: int
) -> dict[str, Json]:
    name = plant.joint_name(at)
    entry: dict[str, Json] = {
        "effect": effect.name,
        "port": effect.port.reported,
        "channel": name,
        "category": effect.category,
    }
    if plant.names_joints:
        entry["joint"] = name
    return {
        **entry,
        "equation": equation_in(effect.__doc__),
        "parameters": list(values),
        "estimate": values,
        "share": share,
    }


def _inside(span: tuple[float, float], number: Number, scale: float) -> tuple[float, float]:
    return max(span[0], number.low * scale), min(span[1], number.high * scale)


def described(plant: Plant) -> dict[str, dict[str, Json]]:
    """The unit of each parameter of the nominal form, and what it is called; empty for a simulator
    of the user's own, whose units nobody declared."""
    return _described(plant.dynamics, plant)


@singledispatch
def _described(_: Dynamics, plant: Plant) -> dict[str, dict[str, Json]]:
    if plant.family not in families():
        return {}
    acceleration, command = unit(Scale.ACCELERATION, plant), unit(Scale.COMMAND, plant)
    measures = {
        "acceleration / command": _per(acceleration, command),
        "acceleration": acceleration,
    }
    return {
        p.name: {"unit": measures.get(p.unit, p.unit), "label": p.called or p.name}
        for p in families()[plant.family].params
    }


@_described.register(CompiledTree)
def _of_links_and_joints(dynamics: CompiledTree, plant: Plant) -> dict[str, dict[str, Json]]:
    """A tree's numbers are in SI units; a gain is in those per unit of the command."""
    table: dict[str, dict[str, Json]] = {}
    for at, name in enumerate(dynamics.tree.joints):
        slides = bool(dynamics.tree.constants[at, SLIDE])
        force, q, inertia = ("N", "m", "kg") if slides else ("N·m", "rad", "kg·m^2")
        units = ("kg", *("kg·m",) * 3, *("kg·m^2",) * 6)
        at_joint = (
            inertia,
            f"{force} s/{q}",
            _per(force, unit(Scale.COMMAND, plant, at)),
            *(f"{force}/{q}",) * 2,
            force,
        )
        for number, measure in zip((*INERTIAL, *AT_JOINT), (*units, *at_joint), strict=True):
            parameter = f"{number}({name})"
            label = CALLED.get(number, parameter)
            table[parameter] = {"unit": measure, "label": label}
    return table


def _per(measure: str, command: str) -> str:
    """A unit for each unit of a command; 1 where both are the same."""
    if measure == command:
        return "1"
    return measure if command == "1" else f"{measure}/{command}"


def parameter_table(plant: Plant, directions: Directions, minima: Minima) -> dict[str, Json]:
    """Nominal and fitted parameters with 95 % intervals; of a tree those that its data determine
    one by one, with damping and dry friction, which no mass takes the place of."""
    limits = _limits(plant.dynamics, plant, directions, minima)
    fitted = directions.determined.copy()
    dissipates = (directions.alone >= 0) & (directions.low == 0.0)
    fitted[directions.alone[dissipates]] = True
    called = described(plant)
    return {
        name: {
            "nominal": nominal,
            "value": float(value),
            "ci95": [float(low), float(high)],
            **called.get(name, {}),
        }
        for (name, nominal), value, (low, high), determined in zip(
            plant.nominal.items(), minima.best.values, limits, fitted, strict=False
        )
        if determined
    }


@singledispatch
def _limits(
    _: Dynamics, plant: Plant, directions: Directions, minima: Minima
) -> list[tuple[float, float]]:
    """95 % intervals of the nominal form's numbers, which move one by one."""
    spans = intervals(minima)
    return [spans["", name] for name in directions.names]


@_limits.register(CompiledTree)
@_limits.register(SimulatedDynamics)
def _limits_of_some(
    _: Dynamics, plant: Plant, directions: Directions, minima: Minima
) -> list[tuple[float, float]]:
    widths = np.array([_tree_widths(plant, directions, f, minima) for f in minima.fits])
    values = np.array([f.values[: len(plant.parameters)] for f in minima.fits])
    least = np.full(len(plant.parameters), -np.inf)  # damping and friction are not negative
    alone = directions.alone >= 0
    least[directions.alone[alone]] = directions.low[alone]
    low = np.maximum((values - widths).min(axis=0), least)
    return list(zip(low, (values + widths).max(axis=0), strict=True))


def _tree_widths(plant: Plant, directions: Directions, fit: RolloutFit, minima: Minima) -> Array:
    """Half of each interval of a tree's numbers, which move in combinations, `(numbers,)`."""
    count, numbers = len(directions.names), len(plant.parameters)
    spread = covariance(fit)[:count, :count]
    moved = fit.values[:numbers] - minima.other.values[:numbers]
    wider = minima.widened([("", name) for name in directions.names])
    return np.asarray(
        np.sqrt(
            np.maximum(np.einsum("ai,ab,bi->i", directions.along, spread, directions.along), 0.0)
            * TWO_SIDED**2
            + moved**2
            + np.square(wider[:, None] * directions.along).sum(axis=0)
        )
    )


def shares(search: Search, choice: Choice, nominal: RolloutFit) -> dict[str, float]:
    """Each effect's share of the gap on validation episodes: what comes back of it when the effect
    is removed and the rest refitted.

    They do not add up: what two effects can explain as well as one belongs to neither, and what
    parameters explain is the rest.
    """
    winner = choice.winner
    whole = max(nominal.reduced_chi_square, winner.reduced_chi_square) - winner.reduced_chi_square
    back = {
        n: max(
            search.fitted(winner.hypothesis.without(n), winner).reduced_chi_square
            - winner.reduced_chi_square,
            0.0,
        )
        for n in winner.hypothesis.effects
    }
    scale = max(whole, sum(back.values()), 1e-12)
    return {name: comes_back / scale for name, comes_back in back.items()}


def alternative(plant: Plant, search: Search, rival: Candidate) -> Json:
    """A composition that cannot be told from the answer as it was fitted: its model, its estimates,
    and the nominal form's numbers."""
    minima = Minima(rival.minima, rival.fit)
    values = tuple(float(x) for x in minima.best.values)
    model = Corrected(plant, rival.hypothesis, values, search.problem.scheme)
    described = model.description()
    return {
        "model": {name: described[name] for name in ("parameters", "effects", "scheme")},
        "effects": estimates(minima, search.problem.fitter, plant, {}),
        "parameters": parameter_table(plant, search.problem.fitter.directions, minima),
        "correlations": correlations(rival.fit, search.problem.fitter.directions, plant),
    }
