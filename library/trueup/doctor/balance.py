"""Balance: how well the form of the nominal model explains a log, joint by joint, by regression
alone.

Both sides of the equation of motion are averaged over short spans with a smooth weight that
vanishes at their ends, so that derivatives fall on the weight and not on the samples. Sources: M.
Shinbrot, Transactions of the ASME 79 (1957), method of modulating functions; R. Featherstone, Rigid
Body Dynamics Algorithms (2008), for a robot's forces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from trueup.doctor.tuning import BALANCE
from trueup.episode.episode import Episode
from trueup.fit.base_parameters import columns as tree_columns
from trueup.model.dynamics import CompiledFamily, CompiledTree, Dynamics
from trueup.model.plant import Plant
from trueup.model.series import positions_and_velocities
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.tree import DAMPING, GAIN, JOINT, LINK, OFFSET, SERVO, STIFFNESS

Array = NDArray[np.float64]
STILL = 1e-9  # of a position: a joint that moves by less does not move
POWER = 4  # of the weight (x (1 - x))^POWER: its second derivative is smooth, and 0 at both ends


@dataclass(frozen=True, slots=True)
class Balance:
    """One joint's equation of motion, as a regression over a log.

    `ratios` are the fitted numbers over the nominal ones by name, the command's under `command`,
    `errors` their standard errors; `explained` is the part of the acceleration's variance that the
    form explains; `of_command` is the squared partial correlation of acceleration and command,
    which no scale of either changes.
    """

    ratios: dict[str, float]
    errors: dict[str, float]
    explained: float
    of_command: float
    rows: int

    @property
    def command(self) -> float:
        """The command's factor over the nominal one."""
        return self.ratios["command"]

    @property
    def certainty(self) -> float:
        """The command's factor in its standard errors."""
        return abs(self.ratios["command"]) / max(self.errors["command"], 1e-300)


@dataclass(frozen=True, slots=True)
class Averages:
    """Positions, velocities, accelerations and commands `(rows, joints)` each, averaged."""

    q: Array
    v: Array
    a: Array
    u: Array


def weights(samples: int, period_s: float) -> tuple[Array, Array, Array]:
    """The weight over so many samples, and its first and second derivatives by time."""
    x = (np.arange(samples) + 0.5) / samples
    p = POWER
    inner, slope = x * (1.0 - x), 1.0 - 2.0 * x
    weight = inner**p
    first = p * inner ** (p - 1) * slope
    second = p * (p - 1) * inner ** (p - 2) * slope**2 - 2.0 * p * inner ** (p - 1)
    total, length_s = float(weight.sum()), samples * period_s
    return weight / total, first / total / length_s, second / total / length_s**2


def evenly(plant: Plant, episode: Episode) -> tuple[Array, Array]:
    """Positions and commands `(samples, joints)` at instants a median period apart; a command
    counts for half of the interval before and half of that after."""
    period_s = episode.period_s
    t = np.arange(0.0, float(episode.t_s[-1]), period_s)
    joints = len(plant.joints)
    observed = positions_and_velocities(plant, episode)[:, :joints]
    q = np.stack([interpolated(t, episode.t_s, column) for column in observed.T], axis=1)
    index = np.clip(
        np.searchsorted(episode.t_s, t + 1e-9, side="right") - 1, 0, len(episode.t_s) - 1
    )
    issued = episode.commands[index]
    u = plant.at_joints(issued)
    return q, (u + np.concatenate([u[:1], u[:-1]])) / 2.0


def interpolated(t: Array, known_t: Array, values: Array) -> Array:
    """Values at instants `t`, on lines between those that are numbers; nan where none is."""
    known = np.isfinite(values)
    return np.interp(t, known_t[known], values[known]) if known.any() else np.full(len(t), np.nan)


def averages(plant: Plant, episode: Episode, samples: int) -> Averages:
    """Averages over spans of so many samples that overlap by half."""
    q, u = evenly(plant, episode)
    if len(q) <= samples:
        nothing = np.zeros((0, len(plant.joints)))
        return Averages(nothing, nothing, nothing, nothing)
    starts = np.arange(0, len(q) - samples + 1, max(1, samples // 2))
    at = starts[:, None] + np.arange(samples)
    weight, first, second = weights(samples, episode.period_s)
    return Averages(
        np.einsum("s,rsj->rj", weight, q[at]),
        -np.einsum("s,rsj->rj", first, q[at]),
        np.einsum("s,rsj->rj", second, q[at]),
        np.einsum("s,rsj->rj", weight, u[at]),
    )


def balances(plant: Plant, episodes: Sequence[Episode]) -> list[Balance | None]:
    """For each joint the best balance over the lengths of spans, None where the log is too short
    or nothing moves."""
    best: list[Balance | None] = [None] * len(plant.joints)
    for samples in BALANCE.spans:
        parts = [averages(plant, e, samples) for e in episodes]
        data = Averages(
            *(np.concatenate([getattr(p, x) for p in parts]) for x in ("q", "v", "a", "u"))
        )
        if len(data.q) < BALANCE.fewest_rows:
            continue
        for j in range(len(plant.joints)):
            balance = balance_of(plant, data, j)
            known = best[j]
            if balance and (known is None or balance.explained > known.explained):
                best[j] = balance
    return best


def balance_of(plant: Plant, data: Averages, joint: int) -> Balance | None:
    """The balance of one joint; None where it does not move, or too little is known of it."""
    target, known, names = _sides(plant.dynamics, plant, data, joint)
    v, q = data.v[:, joint], data.q[:, joint]
    if not np.nanmax(np.abs(q - q[0]), initial=0.0) > STILL * max(abs(float(q[0])), STILL):
        return None
    design = np.column_stack([known, np.sign(v), np.ones_like(v)])
    finite = np.isfinite(design).all(axis=1) & np.isfinite(target)
    design, target = design[finite], target[finite]
    if len(target) <= 2 * design.shape[1]:
        return None
    size = np.sqrt(np.mean(design**2, axis=0))
    used = size > 0.0
    power = float(np.sum((target - target.mean()) ** 2))
    if not used[0] or power <= 0.0:
        return None
    scaled = design[:, used] / size[used]
    values, _, rank, _ = np.linalg.lstsq(scaled, target, rcond=1e-9)
    left = target - scaled @ values
    variance = float(left @ left) / max(1, len(target) - int(rank))
    covariance = np.linalg.pinv(scaled.T @ scaled) * variance
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / size[used]
    values = values / size[used]
    others = np.linalg.lstsq(scaled[:, 1:], target, rcond=1e-9)[0]
    without = target - scaled[:, 1:] @ others
    order = np.flatnonzero(used)
    fitted = {
        names[c]: (float(x), float(e))
        for c, x, e in zip(order, values, errors, strict=True)
        if c < len(names)
    }
    return Balance(
        {name: x for name, (x, _) in fitted.items()},
        {name: e for name, (_, e) in fitted.items()},
        1.0 - float(left @ left) / power,
        1.0 - float(left @ left) / max(float(without @ without), 1e-300),
        len(target),
    )


@singledispatch
def _sides(
    dynamics: Dynamics, plant: Plant, data: Averages, joint: int
) -> tuple[Array, Array, list[str]]:
    raise TypeError(type(dynamics).__name__)


@_sides.register
def _sides_of_family(
    dynamics: CompiledFamily, plant: Plant, data: Averages, joint: int
) -> tuple[Array, Array, list[str]]:
    """Acceleration, and what each nominal number gives of it, the command's first."""
    q, v, u = data.q[:, joint], data.v[:, joint], data.u[:, joint]
    factors = np.stack(dynamics.family.regressors(q, v, u), axis=1) * np.array(plant.parameters)
    moving = dynamics.family.regressors(np.zeros(1), np.zeros(1), np.ones(1))
    command = int(np.argmax([abs(float(x[0])) for x in moving]))
    names = list(dynamics.parameter_names)
    order = [command, *(i for i in range(len(names)) if i != command)]
    return (
        data.a[:, joint],
        factors[:, order],
        ["command", *(names[i] for i in order[1:])],
    )


@_sides.register
def _sides_of_simulator(
    dynamics: SimulatedDynamics, plant: Plant, data: Averages, joint: int
) -> tuple[Array, Array, list[str]]:
    """Acceleration, and what the nominal simulator gives of it by the command and without."""
    numbers, states = np.array(plant.parameters), np.concatenate([data.q, data.v], axis=1)
    own = dynamics.acceleration(numbers, states, data.u)[:, joint]
    undriven = data.u.copy()
    undriven[:, joint] = 0.0
    passive = dynamics.acceleration(numbers, states, undriven)[:, joint]
    return data.a[:, joint], np.column_stack([own - passive, passive]), ["command", "passive"]


@_sides.register
def _sides_of_tree(
    dynamics: CompiledTree, plant: Plant, data: Averages, joint: int
) -> tuple[Array, Array, list[str]]:
    """The force that the nominal links and springs need at the joint, and the command's, besides a
    damper."""
    links = LINK * len(plant.joints)
    columns, needed = tree_columns(plant, data.q, data.v, data.a, data.u)
    given = np.array(plant.parameters)
    own = links + JOINT * joint
    at = columns[:, joint]
    passive = sum(at[:, own + k] * given[own + k] for k in (DAMPING, SERVO, STIFFNESS))
    target = needed[:, joint] + passive - dynamics.tree.constants[joint, OFFSET]
    command = given[own + GAIN] * data.u[:, joint]
    return target, np.column_stack([command, data.v[:, joint]]), ["command"]
