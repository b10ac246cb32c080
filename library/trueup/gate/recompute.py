"""Recompute a decision from its gate, its artifacts and its episodes, and compare it with the
recorded one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
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
    """The document of a decision, computed anew. `predictors` are its `models`, by name; `plant` is
    the plant's digest.

    Raises BadGate if the gate is not the one that the decision names.
    """
    declared = Gate.from_document(gate)
    if declared.digest != recorded["gate"]:
        raise BadGate(
            "the gate is not the one that the decision names",
            expected=recorded["gate"],
            found=declared.digest,
        )
    discloses = "known" in recorded
    beside = recorded["figures"].get("beside")
    run = run_trial(
        declared if discloses else _believed(declared),
        predictors["candidate"],
        predictors["incumbent"],
        episodes,
        progress,
        beside=None if beside is None else {digest: predictors[digest] for digest in beside},
    )
    selected = ("selection",) if "selection" in recorded else ()
    named = {
        name: recorded[name]
        for name in (
            "candidate",
            "incumbent",
            "generation",
            *(("known", "uses") if discloses else ()),
            *selected,
        )
    }
    made = judge(
        declared, run.trial, plant=plant, controls=run.controls, beside=run.beside, **named
    ).document()
    return made if discloses else _only(made, recorded)


def models(recorded: Mapping[str, Any]) -> dict[str, str]:
    """The digests of the artifacts that a decision was made from, by name: `candidate`,
    `incumbent`, and the digest itself for models that were scored beside them."""
    return {
        **{which: recorded[which] for which in ("candidate", "incumbent")},
        **{d: d for d in recorded["figures"].get("beside", {})},
    }


def _believed(gate: Gate) -> Gate:
    """The gate declared as vacuous: at its time, nobody checked whether a gate can reject."""
    return replace(gate, vacuous=True, because=gate.because or "declared before controls were")


def _only(made: Any, recorded: Any) -> Any:
    """The fields that an older decision has too: those had no intervals, no controls and nothing of
    what was known."""
    if isinstance(made, Mapping) and isinstance(recorded, Mapping):
        return {key: _only(value, recorded[key]) for key, value in made.items() if key in recorded}
    if isinstance(made, list) and isinstance(recorded, list) and len(made) == len(recorded):
        return [_only(*pair) for pair in zip(made, recorded, strict=True)]
    return made


def differences(recorded: Any, recomputed: Any, path: str = "") -> list[str]:
    """Where two documents differ by more than rounding. Texts that only repeat figures are left
    out."""
    if (
        isinstance(recorded, Mapping)
        and isinstance(recomputed, Mapping)
        and set(recorded) == set(recomputed)
    ):
        names = [key for key in recorded if key != "because"]
        return [
            d
            for key in names
            for d in differences(recorded[key], recomputed[key], f"{path}.{key}" if path else key)
        ]
    if (
        isinstance(recorded, list)
        and isinstance(recomputed, list)
        and len(recorded) == len(recomputed)
    ):
        return [
            d
            for i, pair in enumerate(zip(recorded, recomputed, strict=True))
            for d in differences(*pair, f"{path}[{i}]")
        ]
    numbers = all(
        isinstance(x, int | float) and not isinstance(x, bool) for x in (recorded, recomputed)
    )
    same = (
        abs(recorded - recomputed) <= AGREEMENT * max(abs(recorded), abs(recomputed))
        if numbers
        else recorded == recomputed
    )
    return [] if same else [f"{path}: recorded {recorded}, recomputed {recomputed}"]
