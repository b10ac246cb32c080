"""Report: a diagnosis as one JSON document, schema `trueup.diagnosis/1`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum

import numpy as np

import trueup
from trueup.canonical import Json
from trueup.diagnose.bounds import Bound
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.correlations import correlations
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.explain import counted
from trueup.diagnose.identifiability import Identifiability
from trueup.diagnose.measure import Gap
from trueup.diagnose.measured_drive import MeasuredDrive
from trueup.diagnose.model_selection import Choice, Conclusion
from trueup.diagnose.next_experiment import Experiment
from trueup.diagnose.payload import Payload
from trueup.diagnose.search import Search
from trueup.diagnose.trimming import Stretch
from trueup.doctor.finding import Finding, documents
from trueup.episode.episode import Episode
from trueup.episode.layout import Hold
from trueup.fit.rollout_fit import TWO_SIDED, RolloutFit
from trueup.model.block import joint, kind
from trueup.model.block import term as term_at
from trueup.model.effect import effects, equation_in
from trueup.model.family import families
from trueup.model.mjcf_patch import Patch
from trueup.model.plant import Plant
from trueup.recording.mapping import guesses_of

SCHEMA = "trueup.diagnosis/1"
LISTED = 25  # hypotheses in the evidence
COMMAND_FILE = "next_experiment.csv"


class Served(StrEnum):
    """What the artifact of a diagnosis is."""

    CORRECTED = "corrected"
    NOMINAL = "nominal"  # nothing predicts held-out episodes better


def report(
    *,
    plant: Plant,
    quality: DataQuality,
    search: Search,
    choice: Choice,
    answer: Candidate,
    nominal: RolloutFit,
    gap: Gap,
    effects: list[Json],
    alternatives: Sequence[Json],
    patch: Patch,
    parameters: Mapping[str, Json],
    between: Sequence[Json],
    excluded: Sequence[Bound],
    unexcited: Sequence[Bound],
    shown: Identifiability,
    carried: Payload | None,
    drives: Sequence[MeasuredDrive],
    put_aside: Sequence[Stretch],
    judged_as: str,
    where: Mapping[str, Json],
    experiment: Experiment | None,
    episodes: Sequence[Episode],
    findings: Sequence[Finding],
    ramps_leave: float | None,
    served: Served,
    seed: int,
) -> dict[str, Json]:
    """The report; `answer` is the choice's winner as it was fitted last, where the search's steps
    and windows left no mark.

    What was counted in the samples is named beside what was fitted, whatever the verdict on the
    rest.
    """
    samples = sum(len(e.t_s) for e in episodes)
    seen = counted(quality, plant, samples)
    verdict = choice.verdict
    named = seen + (effects if verdict is Conclusion.EFFECT else [])
    if named and verdict in (Conclusion.NO_GAP, Conclusion.PARAMETERS_ONLY):
        verdict = Conclusion.EFFECT
    extra = [_named(entry) for entry in seen if isinstance(entry, dict)]
    return {
        "schema": SCHEMA,
        "plant": plant.name,
        "findings": documents(findings),
        "equation": _nominal_equation(plant),
        "verdict": str(verdict),
        "effects": list(named),
        "incomplete": choice.left
        if choice.partial and choice.verdict is Conclusion.EFFECT
        else None,
        "nearest": _nearest(plant, choice) if choice.verdict is Conclusion.UNKNOWN else None,
        "indistinguishable": [
            [*(named_term(plant, t) for t in a), *extra]
            for a in indistinguishable(choice, len(plant.joints))
        ],
        "excluded": [b.document() for b in excluded],
        "not_excited": [b.document() for b in unexcited],
        "identifiability": shown.document(),
        "parameters": dict(parameters),
        "between_recordings": list(between),
        "payload": carried.document() if carried else None,
        **({"mjcf": patch.document()} if plant.family == "mjcf" else {}),
        "where": dict(where),
        "gap": gap.document(),
        "next_experiment": experiment.document(COMMAND_FILE, lambda t: named_term(plant, t))
        if experiment
        else None,
        "evidence": {
            "timestep_s": plant.timestep_s,
            "episodes": [
                {"sha256": e.digest, "role": str(e.role), "period_s": e.period_s}
                for e in sorted(episodes, key=lambda e: e.digest)
            ],
            "guessed": sorted({g for e in episodes for g in guesses_of(e.source)}),
            "hypotheses": _hypotheses(plant, search, choice, nominal),
            "alternatives": list(alternatives),
            "noise": {
                c.name: float(quality.noise[i])
                for i, c in zip(plant.state_columns, plant.layout.observations, strict=True)
            },
            "noise_correlation": {
                c.name: float(quality.correlation[i])
                for i, c in zip(plant.state_columns, plant.layout.observations, strict=True)
            },
            "judged_as": judged_as,
            "witnesses": [d.document() for d in drives],
            "put_aside": [s.document() for s in put_aside],
            "holds": _holds(plant, search, ramps_leave),
            "convergence": _convergence(answer, *choice.rivals),
            "correlations": correlations(answer.fit, search.problem.fitter.directions, plant),
            "uses_of_validation": len(search.candidates),
            "served": str(served),
            "misfit": _finite(choice.winner.reduced_chi_square),
            "unexplained": choice.left,
            **({"not_simulated": _left_out(plant)} if plant.family == "mjcf" else {}),
            **(_of_simulator(plant, search) if plant.family == "simulator" else {}),
            "seed": seed,
            "version": trueup.__version__,
        },
    }


def _nominal_equation(plant: Plant) -> str | None:
    """The equation of the nominal form; None where the model is a robot's or a simulator."""
    family = families().get(plant.family)
    return None if family is None else equation_in(family.__doc__)


def _of_simulator(plant: Plant, search: Search) -> dict[str, Json]:
    """Whether effects at the port of forces could not be tried, and which numbers stay as declared,
    for the recordings show them only together with others."""
    shown = search.problem.fitter.directions.determined
    kept: list[Json] = [n for n, is_shown in zip(plant.nominal, shown, strict=True) if not is_shown]
    return {"no_force": not plant.dynamics.takes_force, "kept_as_declared": kept}


def _nearest(plant: Plant, choice: Choice) -> Json:
    """The composition that comes nearest to the recordings where none explains them, and the part
    of the refitted nominal form's gap that it leaves."""
    return {
        "effects": [named_term(plant, t) for t in choice.winner.hypothesis.effects],
        "leaves": _finite(choice.left),
    }


def _holds(plant: Plant, search: Search, ramps_leave: float | None) -> Json:
    """What each command does between its samples, whether that was declared, and else what the
    refitted nominal form leaves with ramps over what it leaves with steps."""
    ramps = plant.ramps(ramped=search.problem.scheme.ramped)
    return {
        c.name: {
            "hold": str(Hold.FIRST_ORDER if ramp else Hold.ZERO_ORDER),
            "declared": c.hold is not None,
            "ramps_leave": _finite(ramps_leave)
            if c.hold is None and ramps_leave is not None
            else None,
        }
        for c, ramp in zip(plant.layout.commands, ramps, strict=True)
    }


def _convergence(*fitted: Candidate) -> Json:
    """How far the answer's fit and its alternatives' stand from their minima, in half-widths of an
    interval, and how many minima the data leave each.
    """
    return [
        {
            "effects": list(c.hypothesis.effects),
            "off": _finite(c.fit.distance) if c.fit.distance is not None else None,
            "minima": len(c.minima),
        }
        for c in fitted
    ]


def _left_out(plant: Plant) -> Json:
    """What the robot's model has that a rollout does not do: a log during which it acts is not
    explained by it."""
    nominal = plant.document["nominal"]
    return nominal.get("left_out", []) if isinstance(nominal, Mapping) else []


def named_term(plant: Plant, term: str) -> Json:
    """A term as a report has it: the effect's name, with its joint where there are several."""
    return (
        {"effect": kind(term).name, "joint": plant.joint_name(joint(term))}
        if plant.names_joints
        else kind(term).name
    )


def _named(entry: Mapping[str, Json]) -> Json:
    return (
        {"effect": entry["effect"], "joint": entry["joint"]}
        if "joint" in entry
        else entry["effect"]
    )


def indistinguishable(choice: Choice, joints: int = 1) -> list[list[str]]:
    """Compositions that cannot be told from the answer, those of the same law among them."""
    if choice.verdict is not Conclusion.EFFECT:
        return []
    named = [list(c.hypothesis.effects) for c in (choice.winner, *choice.rivals)]
    if joints > 1:
        return named[1:]
    same = []
    for other in effects().values():
        for composition in named:
            alike = [
                term_at(other.name, joint(t)) if kind(t).name == other.same_as else t
                for t in composition
            ]
            if alike != composition:
                same.append(alike)
    return named[1:] + same


def _hypotheses(plant: Plant, search: Search, choice: Choice, nominal: RolloutFit) -> list[Json]:
    rows: list[Json] = [
        {
            "effects": [],
            "parameters": "nominal",
            "misfit": _finite(nominal.reduced_chi_square),
            "validation": _finite(nominal.reduced_chi_square),
        }
    ]
    chosen = {choice.winner.hypothesis, *(r.hypothesis for r in choice.rivals)}
    ranked = sorted((c for c in search if np.isfinite(c.total)), key=lambda c: c.total)
    base = [c for c in ranked if not c.hypothesis.effects]
    listed = {
        c.hypothesis: c
        for c in [*ranked[:LISTED], *base, *(c for c in ranked if c.hypothesis in chosen)]
    }
    rows += [_row(plant, c, choice.winner, in_set=c.hypothesis in chosen) for c in listed.values()]
    return rows


def _row(plant: Plant, c: Candidate, winner: Candidate, *, in_set: bool) -> Json:
    """One composition; `worse_ci95` is by how much its reduced chi-square on validation episodes
    exceeds the answer's, from window to window."""
    worse = c.check.costs - winner.check.costs
    half = TWO_SIDED * float(np.sqrt(len(worse) * np.var(worse))) / c.check.samples
    return {
        "effects": [named_term(plant, t) for t in c.hypothesis.effects],
        "parameters": "fitted",
        "misfit": _finite(c.total),
        "validation": _finite(c.reduced_chi_square),
        "worse_ci95": [
            _finite(c.reduced_chi_square - winner.reduced_chi_square - half),
            _finite(c.reduced_chi_square - winner.reduced_chi_square + half),
        ],
        "answer": c is winner,
        "in_set": in_set,
    }


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
