"""A case as a peer sees it, what its terms mean, and rollouts of its model. numpy only.

A peer gets the recordings of adaptation and validation, the family's own terms, and further terms
with the effect that each stands for. Its answer is a list of effects and the positions that it
predicts on the test recordings, from the samples at the windows' starts on.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

PARTS = 4  # steps of fourth order to a sample


@dataclass(frozen=True)
class Recording:
    """`t` `(n,)`, command `u` `(n,)`, positions and velocities `y` `(n, 2)`."""

    t: np.ndarray
    u: np.ndarray
    y: np.ndarray


@dataclass(frozen=True)
class Case:
    """One plant's recordings. `window` is the horizon in samples."""

    family: str
    parameters: dict[str, float]
    dt: float
    window: int
    adaptation: list[Recording]
    validation: list[Recording]
    test: list[Recording]
    hidden: int  # how many effects to name where there are any: the peers are told, trueup is not


def read(file: Path) -> Case:
    """A case from its npz."""
    z = np.load(file)
    about = json.loads(str(z["about"]))
    parts = {
        role: [
            Recording(z[f"{role}{i}t"], z[f"{role}{i}u"], z[f"{role}{i}y"])
            for i in range(about[role])
        ]
        for role in ("adaptation", "validation", "test")
    }
    return Case(
        about["family"],
        about["parameters"],
        about["dt"],
        about["window"],
        hidden=about["hidden"],
        **parts,
    )


def own_terms(family: str, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The family's own terms of the acceleration, `(n, terms)`."""
    spring = {"oscillator": [q], "pendulum": [np.sin(q)], "inertia": []}[family]
    return np.column_stack([*spring, v, u])


# Terms of the acceleration beyond the family's own, and the effect that each stands for.
TERMS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "coulomb_friction": lambda q, v, u: np.sign(v),
    "quadratic_drag": lambda q, v, u: v * np.abs(v),
    "cubic_stiffness": lambda q, v, u: q**3,
    "constant_force": lambda q, v, u: np.ones_like(q),
    "gain_asymmetry": lambda q, v, u: np.abs(u),
    "load_dependent_friction": lambda q, v, u: np.sign(v) * np.abs(u),
}


def terms(family: str, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Own terms, then those of TERMS, `(n, terms)`."""
    return np.column_stack([own_terms(family, q, v, u), *(f(q, v, u) for f in TERMS.values())])


def starts(recording: Recording, window: int) -> range:
    """Samples at which a rollout begins."""
    return range(0, len(recording.t) - 1, window)


def roll(
    acceleration: Callable[[float, float, float], float],
    recording: Recording,
    window: int,
    dt: float,
) -> np.ndarray:
    """Positions and velocities `(n, 2)`: Runge-Kutta from the observed state at each window's
    start, the command held."""
    found = recording.y.copy()
    h = dt / PARTS
    with np.errstate(over="ignore", invalid="ignore"):
        for begin in starts(recording, window):
            q, v = recording.y[begin]
            for i in range(begin, min(begin + window, len(recording.t) - 1)):
                u = recording.u[i]
                for _ in range(PARTS):
                    a1 = acceleration(q, v, u)
                    a2 = acceleration(q + 0.5 * h * v, v + 0.5 * h * a1, u)
                    a3 = acceleration(q + 0.5 * h * (v + 0.5 * h * a1), v + 0.5 * h * a2, u)
                    a4 = acceleration(q + h * (v + 0.5 * h * a2), v + h * a3, u)
                    q, v = (
                        q + h * v + h * h * (a1 + a2 + a3) / 6.0,
                        v + h * (a1 + 2 * a2 + 2 * a3 + a4) / 6.0,
                    )
                if i + 1 < begin + window:
                    found[i + 1] = q, v
    return found


def linear(case: Case, weights: np.ndarray) -> Callable[[float, float, float], float]:
    """An acceleration that is linear in all terms."""
    own, further = (
        len(weights) - len(TERMS),
        list(zip(TERMS.values(), weights[len(weights) - len(TERMS) :], strict=True)),
    )
    spring = {"oscillator": lambda q: q, "pendulum": np.sin, "inertia": None}[case.family]
    active = [(f, w) for f, w in further if w != 0.0]

    def acceleration(q: float, v: float, u: float) -> float:
        a = weights[own - 2] * v + weights[own - 1] * u
        if spring is not None:
            a += weights[0] * spring(q)
        for f, w in active:
            a += w * f(q, v, u)
        return a

    return acceleration


def error(
    case: Case, recordings: list[Recording], predict: Callable[[Recording], np.ndarray]
) -> float:
    """Mean squared error of the positions, what ran away as inf."""
    with np.errstate(over="ignore", invalid="ignore"):
        found = float(np.mean([np.mean((predict(r)[:, 0] - r.y[:, 0]) ** 2) for r in recordings]))
    return found if np.isfinite(found) else np.inf


def largest(case: Case, weights: np.ndarray, recordings: list[Recording]) -> list[str]:
    """Effects of the largest further terms, as many as are hidden where any are (one where none
    is)."""
    rows = np.concatenate([terms(case.family, r.y[:, 0], r.y[:, 1], r.u) for r in recordings])
    size = np.abs(weights) * rows.std(axis=0)
    size[-len(TERMS) + list(TERMS).index("constant_force")] = abs(
        weights[-len(TERMS) + list(TERMS).index("constant_force")]
    )
    further = dict(zip(TERMS, size[-len(TERMS) :], strict=True))
    return [n for n in sorted(further, key=lambda n: -further[n]) if further[n] > 0.0][
        : max(case.hidden, 1)
    ]


def answer(solve: Callable[[Case], tuple[list[str], Callable[[Recording], np.ndarray]]]) -> None:
    """Answer each npz of a folder with a json and an npy: `python -m … FOLDER OUT`."""
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    for file in sorted(folder.glob("*.npz")):
        case, began = read(file), time.monotonic()
        named, predict = solve(case)
        seconds = time.monotonic() - began
        np.save(out / f"{file.stem}.npy", np.concatenate([predict(r)[:, 0] for r in case.test]))
        (out / f"{file.stem}.json").write_text(json.dumps({"named": named, "seconds": seconds}))
        print(f"{file.stem}: {', '.join(named) or 'none'} in {seconds:.1f} s", flush=True)
