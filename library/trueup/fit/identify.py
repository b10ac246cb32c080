"""Parameter identification: the nominal form with the numbers that the data show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch

import numpy as np

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.base_parameters import directions, recorded_poses, regression
from trueup.fit.free_numbers import STEP
from trueup.fit.least_squares import solve
from trueup.fit.transitions import Transitions, transitions
from trueup.model.dynamics import CompiledFamily, CompiledTree, Dynamics
from trueup.model.limits import unsaturated
from trueup.model.plant import Plant
from trueup.model.predictor import Identified
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.tree import OFFSET

GAUSS_NEWTON = 10  # steps: a simulator's numbers may enter in any way
SAME_NUMBERS = 1e-9  # of their sizes: a step that changes nothing
WORST_CONDITION = 1e6  # of the scaled design: beyond this half of float64's digits are gone


@dataclass(frozen=True, slots=True)
class Identification:
    """Parameters with 95 % half-widths, and how well the data determine them.

    `rank` is the rank of the regression, `condition` its condition number with columns of unit
    length; `residual_rms` is in acceleration units. `health` is empty, or says what speaks against
    the result. `not_identified` says what the episodes could not have shown: the limit of a command
    that never reached it.
    """

    parameters: dict[str, float]
    half_widths: dict[str, float]
    rank: int
    condition: float
    residual_rms: float
    rows: int
    health: tuple[str, ...]
    not_identified: tuple[str, ...] = ()

    def document(self) -> dict[str, Json]:
        """The identification as JSON."""
        estimates: dict[str, Json] = {
            name: {
                "value": value,
                "ci95": [value - self.half_widths[name], value + self.half_widths[name]],
            }
            for name, value in self.parameters.items()
        }
        return {
            "parameters": estimates,
            "rank": self.rank,
            "condition": self.condition,
            "residual_rms": self.residual_rms,
            "rows": self.rows,
            "health": list(self.health),
            "not_identified": list(self.not_identified),
        }


def identify(
    plant: Plant, episodes: Sequence[Episode], progress: Callable[[float], None] = lambda _: None
) -> tuple[Identified, Identification]:
    """Least squares of the velocity's change on the family's regressors, from adaptation episodes
    alone; of a robot's forces on its base parameters.

    Equation: (v' - v) / h = sum of parameter x regressor(q, v, applied u); a velocity that is
    estimated enters over spans. Raises RoleRefused, and NotIdentifiable where the regression's rank
    is below the number of parameters.
    """
    identified, report = _identify(plant.dynamics, plant, episodes, progress)
    commands = np.concatenate([e.commands for e in episodes])
    return identified, replace(report, not_identified=unsaturated(plant, commands))


@singledispatch
def _identify(
    dynamics: Dynamics,
    plant: Plant,
    episodes: Sequence[Episode],
    progress: Callable[[float], None],
) -> tuple[Identified, Identification]:
    raise TypeError(type(dynamics).__name__)


@_identify.register
def _identify_family(
    dynamics: CompiledFamily,
    plant: Plant,
    episodes: Sequence[Episode],
    progress: Callable[[float], None],
) -> tuple[Identified, Identification]:
    data = transitions(plant, episodes)
    progress(0.5)
    design, target = _regression(dynamics, plant, data)
    names = plant.dynamics.parameter_names
    if len(target) <= len(names):
        raise _too_few(len(target), len(names))
    solution = solve(design, target, data.span)
    if solution.rank < len(names) or solution.condition > WORST_CONDITION:
        raise NotIdentifiable(
            (
                f"the regression has rank {solution.rank} of {len(names)} and condition "
                f"{solution.condition:.3g}"
            ),
            rank=solution.rank,
            condition=solution.condition,
        )
    values = tuple(float(x) for x in solution.values)
    health = (
        ()
        if plant.is_stable(values) or not plant.is_stable()
        else ("the identified update is unstable, the nominal one is not",)
    )
    pairs = (
        dict(zip(names, values, strict=True)),
        dict(zip(names, map(float, solution.half_widths), strict=True)),
    )
    progress(1.0)
    return Identified(plant, values), Identification(
        *pairs, solution.rank, solution.condition, solution.residual_rms, len(target), health
    )


def _regression(
    dynamics: CompiledFamily, plant: Plant, data: Transitions
) -> tuple[np.ndarray, np.ndarray]:
    joints = dynamics.joints
    regressors = dynamics.family.regressors(
        data.states[:, 0], data.states[:, joints], plant.applied(data.issued)[:, 0]
    )
    spans = data.sums(data.h_s)
    design = data.sums(np.stack(regressors, axis=1) * data.h_s[:, None]) / spans[:, None]
    return design, data.sums(data.after[:, joints] - data.states[:, joints]) / spans


@_identify.register
def _identify_simulator(
    dynamics: SimulatedDynamics,
    plant: Plant,
    episodes: Sequence[Episode],
    progress: Callable[[float], None],
) -> tuple[Identified, Identification]:
    """A simulator's numbers, as far as its motion shows them, by Gauss and Newton's method on the
    mean accelerations over each step, each joint's in units of how much it changes."""
    data, ways = transitions(plant, episodes), directions(plant, episodes)
    states, u = data.states, plant.applied(data.issued)
    spans, values = data.sums(data.h_s), np.array(plant.parameters)
    velocities, each = slice(dynamics.joints, 2 * dynamics.joints), spans[:, None]
    target = data.sums((data.after - data.states)[:, velocities]) / each
    scale = np.maximum(target.std(axis=0), 1e-9) if dynamics.joints > 1 else np.ones(1)
    if len(target) <= len(ways.names):
        raise _too_few(len(target), len(ways.names))
    sizes = ways.steps / STEP
    for i in range(GAUSS_NEWTON):
        slopes = dynamics.slopes(values, states, u)[:, :, ways.alone]
        own = dynamics.acceleration(values, states, u)
        design = data.sums(slopes * data.h_s[:, None, None]) / each[:, None] * sizes
        missing = target - data.sums(own * data.h_s[:, None]) / each
        solution = solve(
            (design / scale[:, None]).reshape(-1, len(sizes)),
            (missing / scale).reshape(-1),
            data.span * dynamics.joints,
        )
        values[ways.alone] += sizes * solution.values
        progress((i + 1) / GAUSS_NEWTON)
        if np.abs(solution.values).max() < SAME_NUMBERS:
            break
    numbers = map(float, values[ways.alone])
    return Identified(plant, tuple(float(x) for x in values)), Identification(
        dict(zip(ways.names, numbers, strict=True)),
        dict(zip(ways.names, map(float, sizes * solution.half_widths), strict=True)),
        solution.rank,
        solution.condition,
        solution.residual_rms,
        len(target),
        (),
    )


def _too_few(steps: int, numbers: int) -> NotIdentifiable:
    return NotIdentifiable(
        f"{steps} steps are too few to identify {numbers} parameters and their uncertainty",
        hint="Record longer episodes.",
    )


@_identify.register
def _identify_tree(
    dynamics: CompiledTree,
    plant: Plant,
    episodes: Sequence[Episode],
    progress: Callable[[float], None],
) -> tuple[Identified, Identification]:
    """A robot's numbers: what is missing at each joint, in units of the forces there, on the
    combinations that the episodes show.

    Equation: sum of parameter x its column = the actuators' constant forces; source: P. K. Khosla,
    T. Kanade, CDC 1985.
    """
    episodes = [e.require(Role.ADAPTATION) for e in episodes]
    if not episodes:
        raise NotIdentifiable("there is no adaptation episode to fit")
    ways = directions(plant, episodes)
    progress(0.3)
    columns, force = regression(plant, episodes)
    if not len(ways.names):
        raise NotIdentifiable(
            "no motion shows any of the robot's parameters",
            hint="Record episodes in which every joint moves.",
        )
    scale = np.maximum(np.sqrt(np.mean(force**2, axis=0)), 1e-9)
    nominal = np.array(plant.parameters)
    missing = dynamics.tree.constants[:, OFFSET] - columns @ nominal
    design = (columns @ ways.along.T / scale[:, None]).reshape(-1, len(ways.names))
    solution = solve(design, (missing / scale).reshape(-1), len(plant.joints))
    values = nominal + solution.values @ ways.along
    single = ways.alone >= 0
    values[ways.alone[single]] = np.maximum(values[ways.alone[single]], ways.low[single])
    widths = np.sqrt((solution.half_widths**2) @ ways.along**2)
    progress(1.0)
    determined = [i for i in range(len(nominal)) if ways.determined[i]]
    names = plant.dynamics.parameter_names
    document = Identification(
        {names[i]: float(values[i]) for i in determined},
        {names[i]: float(widths[i]) for i in determined},
        solution.rank,
        solution.condition,
        solution.residual_rms,
        len(design),
        _sound(plant, values, episodes),
    )
    return Identified(plant, tuple(float(x) for x in values)), document


def _sound(plant: Plant, values: np.ndarray, episodes: Sequence[Episode]) -> tuple[str, ...]:
    """What speaks against a robot's parameters: an inertia that gives way, at a recorded pose."""
    poses = recorded_poses(plant, episodes)
    masses = plant.dynamics.inertia(values, poses) * plant.form.sizes[None, :, None]
    return (
        ()
        if bool((np.linalg.eigvalsh(masses) > 0.0).all())
        else ("the identified inertia is not positive at a recorded pose",)
    )
