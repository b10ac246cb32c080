"""Real machines, recording by recording: what trueup answers and how far its model predicts,
beside fits of textbook friction by the same solver.

Each machine's recordings are dealt into folds. A fold is put aside; of the rest every third
recording compares and the others are fitted. Nothing of a fold is seen before it is predicted, in
windows of the plant's horizon that start from the same filter for every model; of peers the
numbers that they find are put into the nominal form. `CASES=FOLDER` names the folder with case
folders, `ALONE=1` leaves out the peers. `PUBLISH=1` keeps the tables for the pages.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.peers.environment import run_peer
from bench.report import publish
from trueup.diagnose.case import read_case
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import Diagnosis, diagnose
from trueup.diagnose.filtering import corrected
from trueup.diagnose.measure import by_channel, windows_of
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import kind, term
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor
from trueup.model.state import smoothed_states

EXAMPLES = Path(__file__).parent.parent / "examples"
FOLDS = 4
EVERY = 3  # which of the recordings that are left compares
PLAIN = {
    "viscous": (),
    "viscous, Coulomb, offset": ("coulomb_friction", "constant_force"),
    "load-dependent": ("load_dependent_friction",),
}
PEERS = {"mujoco.sysid": "joint_sysid", "FIGAROH": "joint_figaroh"}
MODELS = "nominal", *PLAIN, *PEERS, "trueup"
WINDOWS = 150  # at most that mujoco.sysid is given, evenly from all
RAN_AWAY = 1000.0  # times the nominal model's error
STEP_DIGITS = 6  # of a second
ITERATIONS = 60


@dataclass(frozen=True)
class Fold:
    """One fold: the diagnosis and its answer, the errors of each model by channel in its unit, and
    the CPU time of the diagnosis [s]."""

    diagnosis: Diagnosis
    answer: str
    errors: dict[str, Sequence[float]]
    seconds: float


def folds(episodes: Sequence[Episode]) -> Iterator[tuple[list[Episode], list[Episode]]]:
    """What is seen and what is put aside, fold by fold."""
    many = min(FOLDS, len(episodes))
    for i in range(many):
        aside = [e for j, e in enumerate(episodes) if j % many == i]
        rest = [e for j, e in enumerate(episodes) if j % many != i]
        roles = [
            Role.VALIDATION if j % EVERY == EVERY - 1 else Role.ADAPTATION for j in range(len(rest))
        ]
        if Role.VALIDATION not in roles:
            roles[-1] = Role.VALIDATION
        yield [replace(e, role=r) for e, r in zip(rest, roles, strict=True)], aside


def measured(plant: Plant, seen: list[Episode], aside: list[Episode]) -> Fold:
    """One fold's answer and errors."""
    began = time.process_time()
    diagnosis = diagnose(plant, seen)
    seconds = time.process_time() - began
    models: dict[str, Predictor] = {"nominal": Nominal(plant), "trueup": diagnosis.predictor}
    for name, effects in PLAIN.items():
        predictor = plain(diagnosis, effects)
        if predictor is not None:
            models[name] = predictor
    errors = {name: root_mean_square(model, aside) for name, model in models.items()}
    return Fold(diagnosis, answer(diagnosis), errors, seconds)


def plain(diagnosis: Diagnosis, effects: Sequence[str]) -> Predictor | None:
    """The nominal form with effects at every driven joint, fitted alone; None where it runs
    away."""
    problem, recordings = diagnosis.search.problem, diagnosis.recordings
    fitter, base = problem.fitter, diagnosis.search.base.fit
    fit: RolloutFit = base
    for name in effects:
        for joint in range(len(recordings.plant.joints)):
            at = term(name, joint)
            if at not in recordings.terms:
                continue
            fits = [
                fitter.fit(
                    problem.adaptation,
                    fit.hypothesis | at,
                    fitter.with_effect(fit.values, at, guess),
                    fit.starts,
                    iterations=ITERATIONS,
                )
                for guess in kind(at).starts
            ]
            fit = min(fits, key=lambda f: f.cost)
    if not np.isfinite(fit.cost):
        return None
    quality = assess(recordings.plant, recordings.adaptation)
    return corrected(recordings.plant, quality, fit, problem.scheme, recordings.adaptation)


def peers(seen: Mapping[str, tuple[Diagnosis, Sequence[Episode]]]) -> dict[str, dict[str, Any]]:
    """What each peer answers to each fold, by peer and fold."""
    answers = {}
    with tempfile.TemporaryDirectory() as temporary:
        cases = Path(temporary) / "cases"
        cases.mkdir()
        for name, (diagnosis, episodes) in seen.items():
            _write(cases / f"{name}.npz", diagnosis.plant, episodes)
        for peer, module in PEERS.items():
            out = Path(temporary) / module
            print(f"{peer} …", flush=True)
            run_peer(module, cases, out)
            answers[peer] = {n: json.loads((out / f"{n}.json").read_text()) for n in seen}
    return answers


def _write(file: Path, plant: Plant, episodes: Sequence[Episode]) -> None:
    arrays = {}
    for i, e in enumerate(episodes):
        states = smoothed_states(plant, e)
        t = np.arange(len(e.t_s)) * round(e.period_s, STEP_DIGITS)
        columns = {
            "t": t,
            "u": plant.applied(e.commands)[:, 0],
            "q": states[:, 0],
            "v": states[:, 1],
        }
        arrays |= {f"{name}{i}": x for name, x in columns.items()}
    samples = sum(len(e.t_s) for e in episodes)
    window = max(2, round(plant.horizon_s / episodes[0].period_s))
    about = {
        "family": plant.family,
        "parameters": dict(plant.nominal),
        "step": round(episodes[0].period_s, STEP_DIGITS),
        "window": window,
        "every": max(1, samples // window // WINDOWS),
        "recordings": len(episodes),
    }
    np.savez(file, about=json.dumps(about), **arrays)


def of_numbers(diagnosis: Diagnosis, numbers: Mapping[str, float]) -> Predictor:
    """The nominal form with a peer's numbers and its dry friction, started from a filter as every
    other model."""
    recordings, problem = diagnosis.recordings, diagnosis.search.problem
    plant, fitter = recordings.plant, problem.fitter
    values = diagnosis.search.base.fit.values.copy()
    values[: len(plant.parameters)] = [numbers[name] for name in plant.nominal]
    values[fitter.block.rows("coulomb_friction")[0]] = numbers["friction"]
    fit = replace(
        diagnosis.search.base.fit, hypothesis=Hypothesis(("coulomb_friction",)), values=values
    )
    quality = assess(plant, recordings.adaptation)
    return corrected(plant, quality, fit, problem.scheme, recordings.adaptation)


def root_mean_square(model: Predictor, episodes: Sequence[Episode]) -> list[float]:
    """RMS error of each channel, in its unit, over windows of the plant's horizon."""
    plant = model.plant
    windows = windows_of(plant, episodes, plant.horizon_s, beginnings=False)
    squares = by_channel(model, windows, np.ones(2 * len(plant.joints)))
    return [float(x) for x in np.sqrt(squares.mean(axis=0))]


def answer(diagnosis: Diagnosis) -> str:
    """The verdict in a few words."""
    document = json.loads(json.dumps(diagnosis.document))
    verdict = document["verdict"]
    effects = " + ".join(map(_effect, document["effects"]))
    rivals = [" + ".join(map(_effect, r)) for r in document["indistinguishable"]]
    return " or ".join([effects or verdict, *rivals[:2]]) + (" …" if len(rivals) > 2 else "")


def _effect(entry: str | Mapping[str, Any]) -> str:
    """An effect's name; of a robot an entry says its joint, too."""
    return entry if isinstance(entry, str) else str(entry["effect"])


def main() -> None:
    """Print and keep the tables."""
    folder = Path(os.environ.get("CASES", EXAMPLES))
    cases = [f for f in sorted(folder.iterdir()) if (f / "plant.json").is_file()]
    rows, told = [], []
    for case in cases:
        plant, episodes = read_case(case)
        measured_folds = {
            f"{case.name}-{i}": (measured(plant, seen, aside), seen, aside)
            for i, (seen, aside) in enumerate(folds(episodes))
        }
        results = {name: fold for name, (fold, _, _) in measured_folds.items()}
        if len(plant.joints) == 1 and not os.environ.get("ALONE"):
            given = {n: (fold.diagnosis, seen) for n, (fold, seen, _) in measured_folds.items()}
            for peer, answers in peers(given).items():
                for name, (fold, _, aside) in measured_folds.items():
                    numbers = answers[name]["numbers"]
                    if numbers is not None:
                        model = of_numbers(fold.diagnosis, numbers)
                        results[name].errors[peer] = root_mean_square(model, aside)
        rows += list(table(case.name, plant, list(results.values())))
        told += [[f"`{case.name}`", f.answer, f"{f.seconds:.0f}"] for f in results.values()]
        for row in (*told[-len(results) :], *rows[-len(plant.layout.observations) :]):
            print(" | ".join(row), flush=True)
    publish("machines", ["machine", "channel", *MODELS], rows)
    publish("answers", ["machine", "answer", "CPU [s]"], told)


def table(name: str, plant: Plant, results: Sequence[Fold]) -> Iterator[list[str]]:
    """A row for each channel: the RMS error of each model over all folds, in its unit."""
    for i, channel in enumerate(plant.layout.observations):
        cells = []
        for model in MODELS:
            errors = [f.errors[model][i] for f in results if model in f.errors]
            full = len(errors) == len(results)
            error = float(np.sqrt(np.mean(np.square(errors)))) if full else np.nan
            least = np.nanmin([f.errors["nominal"][i] for f in results])
            ran_away = error > RAN_AWAY * least
            cells.append("ran away" if ran_away else f"{error:.3g}" if full else "–")
        yield [f"`{name}`", f"{channel.name} [{channel.unit}]", *cells]


if __name__ == "__main__":
    main()
