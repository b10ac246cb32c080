"""Lot: which effects a machine is given, how large, and what the label says of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.blindtrial.bench import nominal
from trueup.canonical import Json
from trueup.diagnose.indistinguishable import ALIASES
from trueup.model.block import AT, joint, term
from trueup.model.dynamics import CompiledTree
from trueup.model.effect import Port, effects
from trueup.model.plant import Plant
from trueup.model.tree import ARMATURE, FRAME, GRAVITY, PARENT, SERVO, SLIDE, STIFFNESS, Tree
from trueup.simulate.machine import BEYOND, Machine
from trueup.simulate.robot import OF_A_SPRING, OF_LOG
from trueup.simulate.robot_trial import RobotBench, draw_robot
from trueup.simulate.trial import CATALOGUE, Bench, Trial, draw

PARTS = {"single": 0.6, "pair": 0.12, "outside": 0.1, "none": 0.1, "faint": 0.08}
GAPS = (0.06, 0.5)  # of the motion: what an effect changes of the position
FAINT = (0.3, 2.0)  # times the noise
LEAST_FAINT = 1e-3  # of the motion, where there is no noise
SPREAD = (0.85, 1.15)  # of the numbers that fit the user's episodes
AS_NOMINAL = 0.25  # of the machines have the nominal numbers
REDRAWN = 5  # times a machine that runs away is drawn again,
VISIBLE = 0.3  # or one with an effect that makes no more of the least gap
MANY = 100  # lots: each sort is among them


@dataclass(frozen=True, slots=True)
class Lot:
    """One machine's fate: terms, each an effect at a joint. A lot of kind `none` has no effect and
    names a `bait`: what only somebody who read the label can answer.
    """

    kind: str
    effects: tuple[str, ...]
    moved: bool
    bait: str | None


def left_out(plant: Plant) -> tuple[str, ...]:
    """Terms that the nominal form takes up on this plant's channels: they make no gap, and nothing
    could name them."""
    if isinstance(plant.dynamics, CompiledTree):
        tree = plant.dynamics.tree
        return tuple(
            t for j in range(len(plant.joints)) for t in _left_out_of_robot(plant, tree, j)
        )
    found = []
    if "k" not in plant.dynamics.parameter_names:
        found += ["sensor_bias"]  # nothing says where zero is
    if len(plant.state_columns) == 1:
        found += [
            "velocity_lag",
            "sensor_scale",
            "clock_skew",
        ]  # there is none; other numbers of the form give the same positions
        found += (
            ["sensor_drift"] if "sensor_bias" in found else []
        )  # a constant force gives the same
    return tuple(found)


def _left_out_of_robot(plant: Plant, tree: Tree, j: int) -> list[str]:
    """The same at one joint of a robot."""
    constants, own = tree.constants[j], tree.at_joint[j]
    held = own[SERVO] or own[STIFFNESS]
    down = constants[GRAVITY : GRAVITY + 3]
    moves_alike = constants[PARENT] < 0.0 and (
        constants[SLIDE] or np.allclose(np.cross(constants[FRAME + 6 : FRAME + 9], down), 0.0)
    )
    last = j not in tree.constants[:, PARENT]  # its link may be turned as well
    found = (
        ["sensor_bias"] if (moves_alike or last) and not held else []
    )  # nothing says where zero is
    if len(plant.joints) + j not in plant.state_columns:
        found += ["velocity_lag", "sensor_scale", "clock_skew"]
    found += (
        ["elastic_transmission"] if own[ARMATURE] <= 0.0 else []
    )  # no rotor could be behind a spring
    found += (
        [name for name, effect in effects().items() if effect.port is Port.COMMAND]
        if plant.command_columns[j] < 0
        else []
    )
    return [term(name, j) for name in found]


def draw_lots(plant: Plant, count: int, rng: np.random.Generator) -> list[Lot]:
    """So many lots in the proportions of PARTS, in random order; single effects come in turn, so
    that each is met as often.

    Of a robot each effect acts at a joint by lot, two of them at two joints.
    """
    none = left_out(plant)
    known = [name for name in CATALOGUE if _places(plant, name, none)]
    fitted = [
        name for name in known if name != "dropped_frames"
    ]  # a frame is lost or is not: no loss is faint
    beyond = [
        name for name in BEYOND if name not in OF_A_SPRING or "k" in plant.dynamics.parameter_names
    ]
    kinds = [
        "none",
        *(
            kind
            for kind, part in PARTS.items()
            for _ in range(round(part * count) - (kind == "none"))
        ),
    ]  # one bait at least
    kinds = (kinds + ["single"] * count)[:count]
    turns = {
        kind: _turns({"outside": beyond, "faint": fitted}.get(kind, known), rng) for kind in PARTS
    }

    def placed(name: str, elsewhere: int = -1) -> str:
        places = [j for j in _places(plant, name, none) if j != elsewhere]
        return term(name, places[int(rng.integers(len(places)))] if len(places) > 1 else places[0])

    lots = []
    for kind in kinds:
        moved = bool(rng.random() >= AS_NOMINAL)
        if kind == "none":
            lots.append(Lot(kind, (), moved, placed(next(turns[kind]))))
        elif kind == "pair":
            first = placed(next(turns[kind]))
            here = joint(first) if len(plant.joints) > 1 else -1
            other = next(
                n
                for n in turns[kind]
                if _apart(_name(first), n) and set(_places(plant, n, none)) - {here}
            )
            lots.append(Lot(kind, (first, placed(other, here)), moved, None))
        else:
            lots.append(Lot(kind, (placed(next(turns[kind])),), moved, None))
    return [lots[i] for i in rng.permutation(len(lots))]


def _places(plant: Plant, name: str, none: Sequence[str]) -> list[int]:
    """Joints at which an effect may act, of which `none` is left out; what acts on a whole log acts
    at the first."""
    joints = 1 if name in OF_LOG else len(plant.joints)
    return [j for j in range(joints) if term(name, j) not in none]


def _apart(one: str, other: str) -> bool:
    """Whether two effects are two: neither the same, nor of one law, nor twins."""
    laws = {effects()[n].same_as or n for n in (one, other)}
    return len(laws) == 2 and frozenset((one, other)) not in ALIASES  # noqa: PLR2004


def _turns(names: Sequence[str], rng: np.random.Generator) -> Iterator[str]:
    """The names in random order, again and again."""
    while True:
        yield from (names[i] for i in rng.permutation(len(names)))


def machine_of(
    plant: Plant, bench: Bench | RobotBench, lot: Lot, rng: np.random.Generator
) -> Trial:
    """A machine of a lot and its recordings."""
    gaps = GAPS
    if lot.kind == "faint":
        noise = max(_noise(bench), LEAST_FAINT)
        gaps = (FAINT[0] * noise, FAINT[1] * noise)
    counted = {name for name, effect in effects().items() if effect.counted}
    for _ in range(REDRAWN):
        if isinstance(bench, RobotBench):
            trial = draw_robot(
                bench, [(_name(t), joint(t)) for t in lot.effects], lot.moved, rng, gaps, SPREAD
            )
        else:
            trial = draw(
                bench if lot.moved else nominal(plant, bench),
                lot.effects,
                lot.moved,
                rng,
                gaps,
                SPREAD,
            )
        seen = (
            bool(counted.intersection(map(_name, lot.effects)))
            or not lot.effects
            or trial.gap >= VISIBLE * gaps[0]
        )
        if seen and all(
            np.isfinite(run.observed).all() and np.isfinite(run.issued).all()
            for _, run in trial.runs
        ):
            break
        if not seen:  # a drive that is hardly used cannot grow hot: another effect is hidden
            lot = replace(lot, effects=_drawn(plant, lot, rng))
    return trial


def _drawn(plant: Plant, lot: Lot, rng: np.random.Generator) -> tuple[str, ...]:
    """As many effects as a lot has, of the same sort, by lot."""
    return next(other.effects for other in draw_lots(plant, MANY, rng) if other.kind == lot.kind)


def _noise(bench: Bench | RobotBench) -> float:
    """Noise in parts of the motion, of the channel that has most."""
    if isinstance(bench, Bench):
        return bench.noise
    motion = np.concatenate([p.reached for p in bench.recorded]).std(axis=0)
    return float(np.max(bench.sigma / motion))


def label_of(plant: Plant, lot: Lot, trial: Trial) -> Mapping[str, Json]:
    """What is true of a machine: its effects with their numbers, its parameters where they can be
    told one by one, the gap that an effect makes."""
    m = trial.machine
    numbers = {"k": m.k, "c": m.c, "b": m.b} if isinstance(m, Machine) else {}
    hidden = (
        m.imperfections
        if isinstance(m, Machine)
        else {term(*at): values for at, values in m.imperfections.items()}
    )
    return {
        "kind": lot.kind,
        "effects": {
            _spelled(plant, t): {k: float(v) for k, v in values.items()}
            for t, values in hidden.items()
        },
        "parameters": {
            name: float(numbers[name]) for name in plant.dynamics.parameter_names if name in numbers
        },
        "moved": lot.moved,
        "bait": _spelled(plant, lot.bait) if lot.bait else None,
        "gap": float(trial.gap),
    }


def spelled_out(plant: Plant) -> list[str]:
    """What is left out, as labels have it."""
    return list(dict.fromkeys(_spelled(plant, t) for t in left_out(plant)))


def _spelled(plant: Plant, of: str) -> str:
    """A term as a label has it."""
    return spelled(_name(of), plant.joint_name(joint(of)) if len(plant.joints) > 1 else "")


def _name(of: str) -> str:
    """The name in a term, in the catalogue or beyond."""
    return of.partition(AT)[0]


def spelled(name: str, joint: str = "") -> str:
    """An effect as labels and tallies have it: `cogging at j2`, or `cogging` where there is one
    joint or it acts on a whole log."""
    return f"{name} at {joint}" if joint and name not in OF_LOG else name
