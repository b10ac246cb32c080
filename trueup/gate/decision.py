"""Gate and Decision: a rule frozen before any score, and what it decided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from trueup.canonical import Json, digest_of
from trueup.errors import BadGate
from trueup.fit.score import EVERY, FIRST, Score, Scoring
from trueup.gate.rule import Rule, Verdict, rules

SCHEMA = "trueup.gate/1"
NEEDED = {"schema", "rules", "scoring"}
HOLDS = f"A gate holds schema ({SCHEMA}), rules, and scoring (horizon_s, windows)."
DECISION_SCHEMA = "trueup.decision/1"


@dataclass(frozen=True)
class Gate:
    """Rules, all of which must pass, and the scoring they judge. Its digest freezes them. Raises BadGate without rules.

    `conditions` are those whose values make the cells of retained conditions. After `held_out_uses` trials an episode is spent: whoever
    chooses among candidates by it again and again fits to it.
    """

    rules: tuple[Rule, ...]
    scoring: Scoring
    conditions: tuple[str, ...] = ()
    held_out_uses: int | None = None

    def __post_init__(self) -> None:
        if not self.rules:
            raise BadGate("a gate without rules would pass everything")
        if not (np.isfinite(self.scoring.horizon_s) and self.scoring.horizon_s > 0.0) or self.scoring.windows not in (FIRST, EVERY):
            raise BadGate("a gate scores over a positive horizon, from the `first` window or from `every` one")
        if self.held_out_uses is not None and self.held_out_uses < 1:
            raise BadGate("a held-out episode must be good for one use at least")

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical document."""
        return digest_of(self.document())

    def document(self) -> dict[str, Json]:
        """The gate as JSON."""
        return {
            "schema": SCHEMA,
            "rules": [{"rule": r.name, **asdict(r)} for r in self.rules],  # type: ignore[call-overload]
            "scoring": self.scoring.document(),
            **({"conditions": list(self.conditions)} if self.conditions else {}),
            **({"held_out_uses": self.held_out_uses} if self.held_out_uses is not None else {}),
        }

    @staticmethod
    def from_document(document: Mapping[str, Json]) -> Gate:
        """Read a gate. Raises BadGate."""
        try:
            if document["schema"] != SCHEMA or not NEEDED <= set(document) <= NEEDED | {"conditions", "held_out_uses"}:
                raise BadGate(f"a gate holds schema ({SCHEMA}), rules, scoring, and if it likes conditions and held_out_uses, nothing else")
            given: Any = document
            scoring = Scoring(float(given["scoring"]["horizon_s"]), str(given["scoring"]["windows"]))
            uses = given.get("held_out_uses")
            conditions = tuple(str(c) for c in given.get("conditions", ()))
            return Gate(tuple(_rule(r) for r in given["rules"]), scoring, conditions, None if uses is None else int(uses))
        except KeyError as error:
            raise BadGate(f"a gate needs {error.args[0]!r}", hint=HOLDS) from error
        except (TypeError, ValueError, OverflowError) as error:
            raise BadGate(f"the gate cannot be read: {error!r}") from error


def _rule(document: Mapping[str, Json]) -> Rule:
    given = dict(document)
    kind = rules().get(str(given.pop("rule")))
    if kind is None:
        raise BadGate(f"the rule {document['rule']!r} is not known", hint=f"Rules are {', '.join(rules())}.")
    known = {f.name for f in fields(kind)}  # type: ignore[arg-type]
    if set(given) - known:
        raise BadGate(f"the rule {kind.name} has no {', '.join(sorted(set(given) - known))}", hint=f"It has {', '.join(sorted(known))}.")
    bounds = {key: float(value) for key, value in given.items()}  # type: ignore[arg-type]
    if not all(np.isfinite(v) and v > 0.0 for v in bounds.values()):
        raise BadGate(f"the bounds of {kind.name} must be positive numbers")
    return kind(**bounds)


def default_gate(horizon_s: float) -> Gate:
    """Rollout mean below 0.98 of the incumbent's and one-step error no worse, over every window of each episode."""
    return Gate((rules()["rollout_improves"](), rules()["one_step_no_worse"]()), Scoring(horizon_s, EVERY))


@dataclass(frozen=True)
class Decision:
    """What a gate decided of a candidate against the incumbent that served at `generation`.

    It holds every figure, so that it can be recomputed, and the generation, so that it cannot be replayed after a move.
    """

    plant: str
    gate: str
    candidate: str
    incumbent: str
    generation: int
    episodes: tuple[str, ...]
    verdicts: tuple[Verdict, ...]
    figures: Mapping[str, Json]

    @property
    def accepted(self) -> bool:
        """Whether every rule passed."""
        return all(v.passed for v in self.verdicts)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical document: the decision's name."""
        return digest_of(self.document())

    def document(self) -> dict[str, Json]:
        """The decision as JSON."""
        return {
            "schema": DECISION_SCHEMA,
            "plant": self.plant,
            "gate": self.gate,
            "candidate": self.candidate,
            "incumbent": self.incumbent,
            "generation": self.generation,
            "episodes": list(self.episodes),
            "accepted": self.accepted,
            "verdicts": [v.document() for v in self.verdicts],
            "figures": self.figures,
        }


def figures(score: Score) -> dict[str, Json]:
    """A score as JSON, one number for each episode; what is no number stands as null."""
    return {"rollout": _numbers(score.rollout), "one_step": _numbers(score.one_step)}


def _numbers(values: np.ndarray) -> list[Json]:
    return [float(x) if np.isfinite(x) else None for x in values]
