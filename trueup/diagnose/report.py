"""Report: a diagnosis as one JSON document, schema `trueup.diagnosis/1`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

import trueup
from trueup.canonical import Json
from trueup.diagnose.admission import Admission
from trueup.diagnose.decide import Choice, Verdict, total
from trueup.diagnose.explain import Bound, counted
from trueup.diagnose.measure import Gap
from trueup.diagnose.probe import Experiment
from trueup.diagnose.search import Candidate, Search
from trueup.episode.episode import Episode
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.effect import effects
from trueup.model.plant import Plant

SCHEMA = "trueup.diagnosis/1"
LISTED = 25  # hypotheses in the evidence
COMMAND_FILE = "next_experiment.csv"


def report(
    *,
    plant: Plant,
    admission: Admission,
    search: Search,
    choice: Choice,
    nominal: RolloutFit,
    gap: Gap,
    effects: list[Json],
    parameters: Mapping[str, Json],
    excluded: Sequence[Bound],
    unexcited: Sequence[Bound],
    where: Mapping[str, Json],
    experiment: Experiment | None,
    episodes: Sequence[Episode],
    seed: int,
) -> dict[str, Json]:
    """The report. What was counted in the samples is named beside what was fitted, whatever the verdict on the rest."""
    samples = sum(len(e.t_s) for e in episodes)
    seen = counted(admission, plant, samples)
    verdict = choice.verdict
    named = seen + (effects if verdict is Verdict.EFFECT else [])
    if named and verdict in (Verdict.NO_GAP, Verdict.PARAMETERS_ONLY):
        verdict = Verdict.EFFECT
    extra = [str(entry["effect"]) for entry in seen if isinstance(entry, dict)]
    return {
        "schema": SCHEMA,
        "plant": plant.name,
        "verdict": str(verdict),
        "effects": list(named),
        "indistinguishable": [[*a, *extra] for a in alternatives(choice)],
        "excluded": [b.document() for b in excluded],
        "not_excited": [b.document() for b in unexcited],
        "parameters": dict(parameters),
        "where": dict(where),
        "gap": gap.document(),
        "next_experiment": experiment.document(COMMAND_FILE) if experiment else None,
        "evidence": {
            "episodes": [{"sha256": e.digest, "role": str(e.role)} for e in episodes],
            "hypotheses": _hypotheses(search, choice, nominal),
            "noise": {c.name: float(admission.noise[i]) for i, c in zip(plant.state_columns, plant.layout.observations, strict=True)},
            "uses_of_validation": len(search.found),
            "unexplained": choice.left,
            "seed": seed,
            "version": trueup.__version__,
        },
    }


def alternatives(choice: Choice) -> list[list[str]]:
    """Compositions that cannot be told from the answer, those of the same law among them."""
    if choice.verdict is not Verdict.EFFECT:
        return []
    named = [list(c.hypothesis.effects) for c in (choice.winner, *choice.rivals)]
    same = [[other.name if e == other.same_as else e for e in n] for other in effects().values() for n in named if other.same_as in n]
    return named[1:] + same


def _hypotheses(search: Search, choice: Choice, nominal: RolloutFit) -> list[Json]:
    rows: list[Json] = [{"effects": [], "parameters": "nominal", "misfit": _finite(nominal.misfit), "validation": _finite(nominal.misfit)}]
    chosen = {choice.winner.hypothesis, *(r.hypothesis for r in choice.rivals)}
    ranked = sorted((c for c in search if np.isfinite(total(c))), key=total)
    base = [c for c in ranked if not c.hypothesis.effects]
    listed = {c.hypothesis: c for c in [*ranked[:LISTED], *base, *(c for c in ranked if c.hypothesis in chosen)]}
    rows += [_row(c, in_set=c.hypothesis in chosen) for c in listed.values()]
    return rows


def _row(c: Candidate, *, in_set: bool) -> Json:
    return {
        "effects": list(c.hypothesis.effects),
        "parameters": "fitted",
        "misfit": _finite(total(c)),
        "validation": _finite(c.misfit),
        "in_set": in_set,
    }


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
