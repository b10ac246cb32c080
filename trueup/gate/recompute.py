"""Recompute: a decision from its gate, its artifacts and its episodes, held against what was recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.errors import BadGate
from trueup.gate.decision import Gate
from trueup.gate.judge import judge, run_trial
from trueup.model.predictor import Predictor

AGREEMENT = 1e-9  # relative: matrix products differ by some 1e-13 between processors


def recompute(
    recorded: Mapping[str, Any],
    gate: Mapping[str, Json],
    predictors: Mapping[str, Predictor],
    episodes: Sequence[Episode],
    plant: str,
    progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Json]:
    """The document of a decision as its bytes give it: `predictors` are its `candidate` and `incumbent`, `plant` the plant's digest.

    Raises BadGate if the gate is not the one that the decision names.
    """
    declared = Gate.from_document(gate)
    if declared.digest != recorded["gate"]:
        raise BadGate("the gate is not the one that the decision names", expected=recorded["gate"], found=declared.digest)
    trial = run_trial(declared, predictors["candidate"], predictors["incumbent"], episodes, progress)
    named = {name: recorded[name] for name in ("candidate", "incumbent", "generation")}
    return judge(declared, trial, plant=plant, **named).document()


def differences(recorded: Any, recomputed: Any, path: str = "") -> list[str]:
    """Where two documents differ by more than rounding; texts that only repeat figures are left out."""
    if isinstance(recorded, Mapping) and isinstance(recomputed, Mapping) and set(recorded) == set(recomputed):
        names = [key for key in recorded if key != "because"]
        return [d for key in names for d in differences(recorded[key], recomputed[key], f"{path}.{key}" if path else key)]
    if isinstance(recorded, list) and isinstance(recomputed, list) and len(recorded) == len(recomputed):
        return [d for i, pair in enumerate(zip(recorded, recomputed, strict=True)) for d in differences(*pair, f"{path}[{i}]")]
    numbers = all(isinstance(x, int | float) and not isinstance(x, bool) for x in (recorded, recomputed))
    same = abs(recorded - recomputed) <= AGREEMENT * max(abs(recorded), abs(recomputed)) if numbers else recorded == recomputed
    return [] if same else [f"{path}: recorded {recorded}, recomputed {recomputed}"]
