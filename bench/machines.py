"""Real machines, recording by recording: what trueup answers and how far its model predicts,
beside fits of textbook friction by the same solver.

Each machine's recordings are dealt into folds. A fold is put aside; of the rest every third
recording compares and the others are fitted. Nothing of a fold is seen before it is predicted, in
windows of the plant's horizon that start from the same filter for every model. `CASES=FOLDER` names
the folder with case folders. `PUBLISH=1` keeps the tables for the pages.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

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
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor

EXAMPLES = Path(__file__).parent.parent / "examples"
FOLDS = 4
EVERY = 3  # which of the recordings that are left compares
PLAIN = {
    "viscous": (),
    "viscous, Coulomb, offset": ("coulomb_friction", "constant_force"),
    "load-dependent": ("load_dependent_friction",),
}
ITERATIONS = 60


@dataclass(frozen=True)
class Fold:
    """One fold: the answer, the errors of each model by channel in its unit, and the CPU time of
    the diagnosis [s]."""

    answer: str
    errors: Mapping[str, Sequence[float]]
    seconds: float


def folds(
    plant: Plant, episodes: Sequence[Episode]
) -> Iterator[tuple[list[Episode], list[Episode]]]:
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
    return Fold(answer(diagnosis), errors, seconds)


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
    effects = " + ".join(e["effect"] for e in document["effects"])
    rivals = [" + ".join(r) for r in document["indistinguishable"]]
    return " or ".join([effects or verdict, *rivals[:2]]) + (" …" if len(rivals) > 2 else "")


def main() -> None:
    """Print and keep the tables."""
    cases = sorted(
        f for f in Path(os.environ.get("CASES", EXAMPLES)).iterdir() if (f / "plant.json").is_file()
    )
    table: dict[str, list[Fold]] = {}
    rows = []
    for case in cases:
        plant, episodes = read_case(case)
        names = [c.name for c in plant.layout.observations]
        table[case.name] = []
        for seen, aside in folds(plant, episodes):
            fold = measured(plant, seen, aside)
            table[case.name].append(fold)
            print(f"{case.name}: {fold.answer}, {fold.seconds:.0f} s CPU", flush=True)
            for model, errors in fold.errors.items():
                print(f"    {model:<26}" + "".join(f"{e:>12.4g}" for e in errors), flush=True)
        for i, channel in enumerate(names):
            unit = plant.layout.observations[i].unit
            means = {
                model: float(np.sqrt(np.mean([f.errors[model][i] ** 2 for f in table[case.name]])))
                for model in ("nominal", *PLAIN, "trueup")
                if all(model in f.errors for f in table[case.name])
            }
            cells = [
                f"{means[m]:.3g}" if m in means else "–" for m in ("nominal", *PLAIN, "trueup")
            ]
            rows.append([f"`{case.name}`", f"{channel} [{unit}]", *cells])
            print(" | ".join(rows[-1]), flush=True)
    publish("machines", ["machine", "channel", "nominal", *PLAIN, "trueup"], rows)


if __name__ == "__main__":
    main()
