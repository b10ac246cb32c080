"""Trial specification: which effects a machine is given, how large, and what its label says.

Specifications come in the proportions of PARTS. A label is a mapping of `kind`, `effects` with
their numbers, `parameters`, `moved`, `bait` and `gap`, as the report publishes it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.blindtrial.trial_plant import TrialPlant
from trueup.canonical import Json
from trueup.diagnose.indistinguishable import ALIASES
from trueup.model.block import AT, joint, term
from trueup.model.effect import effects
from trueup.model.plant import Plant
from trueup.simulate.machine import BEYOND
from trueup.simulate.robot import OF_A_SPRING, OF_LOG
from trueup.simulate.trial import CATALOGUE, Bench, SimulatedTrial

PARTS = {"single": 0.6, "pair": 0.12, "outside": 0.1, "none": 0.1, "faint": 0.08}
GAPS = (0.06, 0.5)  # of the motion: what an effect changes of the position
FAINT = (0.3, 2.0)  # times the noise
LEAST_FAINT = 1e-3  # of the motion, where there is no noise
SPREAD = (0.85, 1.15)  # of the numbers that fit the user's episodes
AS_NOMINAL = 0.25  # of the machines have the nominal numbers
REDRAWN = 5  # times a machine that runs away is drawn again,
VISIBLE = 0.3  # or one with an effect that makes no more of the least gap
MANY = 100  # specifications: each kind is among them


@dataclass(frozen=True, slots=True)
class Specification:
    """What is hidden in one machine: `effects` are terms, each an effect at a joint, and `moved`
    says whether its parameters differ from the nominal ones.

    One of kind `none` has no effect and carries a `decoy`: a term that its label names and that
    only a diagnosis that read the label can answer.
    """

    kind: str
    effects: tuple[str, ...]
    moved: bool
    decoy: str | None


def draw_specifications(
    source: TrialPlant, count: int, rng: np.random.Generator
) -> list[Specification]:
    """`count` specifications in the proportions of PARTS, in random order. Single effects come in
    turn, so that each is drawn equally often.

    Each effect acts at a random joint, and the two of a pair at two joints where there are several.
    """
    plant, absorbed = source.plant, source.absorbed_terms()
    known = [name for name in CATALOGUE if _joints_for(plant, name, absorbed)]
    # A frame is lost or is not: no loss is faint.
    fitted = [name for name in known if name != "dropped_frames"]
    beyond = [
        name for name in BEYOND if name not in OF_A_SPRING or "k" in plant.dynamics.parameter_names
    ]
    turns = {
        kind: _turns({"outside": beyond, "faint": fitted}.get(kind, known), rng) for kind in PARTS
    }

    def placed(name: str, elsewhere: int = -1) -> str:
        joints = [j for j in _joints_for(plant, name, absorbed) if j != elsewhere]
        return term(name, joints[int(rng.integers(len(joints)))] if len(joints) > 1 else joints[0])

    drawn = []
    for kind in _kinds(count):
        moved = bool(rng.random() >= AS_NOMINAL)
        if kind == "none":
            drawn.append(Specification(kind, (), moved, placed(next(turns[kind]))))
        elif kind == "pair":
            first = placed(next(turns[kind]))
            here = joint(first) if plant.names_joints else -1
            other = next(
                name
                for name in turns[kind]
                if _apart(_name(first), name) and set(_joints_for(plant, name, absorbed)) - {here}
            )
            drawn.append(Specification(kind, (first, placed(other, here)), moved, None))
        else:
            drawn.append(Specification(kind, (placed(next(turns[kind])),), moved, None))
    return [drawn[i] for i in rng.permutation(len(drawn))]


def _kinds(count: int) -> list[str]:
    """The kinds of `count` specifications; the first is `none`, so that there is a decoy."""
    kinds = ["none"]
    for kind, part in PARTS.items():
        kinds += [kind] * (round(part * count) - (kind == "none"))
    return (kinds + ["single"] * count)[:count]


def _joints_for(plant: Plant, name: str, absorbed: Sequence[str]) -> list[int]:
    """Joints at which an effect may act without being absorbed. An effect on a whole log acts at
    the first."""
    joints = 1 if name in OF_LOG else len(plant.joints)
    return [j for j in range(joints) if term(name, j) not in absorbed]


def _apart(one: str, other: str) -> bool:
    """Whether two effects are two: neither the same, nor of one law, nor indistinguishable."""
    laws = {effects()[n].same_as or n for n in (one, other)}
    return len(laws) == 2 and frozenset((one, other)) not in ALIASES  # noqa: PLR2004


def _turns(names: Sequence[str], rng: np.random.Generator) -> Iterator[str]:
    """The names in random order, again and again."""
    while True:
        yield from (names[i] for i in rng.permutation(len(names)))


def draw_trial(
    source: TrialPlant, bench: Bench, specification: Specification, rng: np.random.Generator
) -> SimulatedTrial:
    """A machine as it is specified, and its recordings.

    One that runs away is drawn again, up to REDRAWN times. An effect that cannot be seen on this
    plant gives way to another.
    """
    gaps = GAPS
    if specification.kind == "faint":
        noise = max(bench.relative_noise(), LEAST_FAINT)
        gaps = (FAINT[0] * noise, FAINT[1] * noise)
    counted = {name for name, effect in effects().items() if effect.counted}
    for _ in range(REDRAWN):
        hidden = [(_name(t), joint(t)) for t in specification.effects]
        trial = bench.draw(hidden, specification.moved, rng, gaps, SPREAD)
        visible = (
            any(name in counted for name, _ in hidden)
            or not hidden
            or trial.gap >= VISIBLE * gaps[0]
        )
        if visible and all(
            np.isfinite(run.observed).all() and np.isfinite(run.issued).all()
            for _, run in trial.runs
        ):
            break
        if not visible:  # a drive that is hardly used cannot grow hot
            others = _effects_of_kind(source, specification.kind, rng)
            specification = replace(specification, effects=others)
    return trial


def _effects_of_kind(source: TrialPlant, kind: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Randomly drawn effects of a specification of one kind."""
    return next(s.effects for s in draw_specifications(source, MANY, rng) if s.kind == kind)


def label_of(
    plant: Plant, specification: Specification, trial: SimulatedTrial
) -> Mapping[str, Json]:
    """The label of a machine: its effects with their numbers, its parameters where a log can show
    each of them, and the gap that an effect makes."""
    numbers = trial.machine.parameters()
    return {
        "kind": specification.kind,
        "effects": {
            _spelled(plant, term(*where)): {k: float(v) for k, v in values.items()}
            for where, values in trial.machine.by_joint().items()
        },
        "parameters": {
            name: float(numbers[name]) for name in plant.dynamics.parameter_names if name in numbers
        },
        "moved": specification.moved,
        "bait": _spelled(plant, specification.decoy) if specification.decoy else None,
        "gap": float(trial.gap),
    }


def absorbed_effects(source: TrialPlant) -> list[str]:
    """What the nominal form absorbs, spelled as in labels, without repetition."""
    return list(dict.fromkeys(_spelled(source.plant, t) for t in source.absorbed_terms()))


def _spelled(plant: Plant, of: str) -> str:
    """A term as a label spells it."""
    return spelled(_name(of), plant.joint_name(joint(of)) if plant.names_joints else "")


def _name(of: str) -> str:
    """The name in a term, in the catalogue or beyond."""
    return of.partition(AT)[0]


def spelled(name: str, joint: str = "") -> str:
    """An effect as labels and scores spell it: `cogging at j2`, or `cogging` where there is one
    joint or it acts on a whole log."""
    return f"{name} at {joint}" if joint and name not in OF_LOG else name
