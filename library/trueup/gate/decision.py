"""Gate and Decision: rules that are frozen by their digest, and what they decided."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from trueup.canonical import Json, digest_of, is_digest
from trueup.errors import BadGate
from trueup.fit.score import EVERY, FIRST, Score, Scoring
from trueup.gate.line import HELD_OUT_USES
from trueup.gate.rule import BOUND, MEAN, Rule, Verdict, rules
from trueup.text import seen

SCHEMA = "trueup.gate/1"
NEEDED = {"schema", "rules", "scoring"}
OPTIONAL = {"conditions", "held_out_uses", "follows", "because", "vacuous"}
HOLDS = f"A gate holds schema ({SCHEMA}), rules, and scoring (horizon_s, windows)."
DECISION_SCHEMA = "trueup.decision/1"
LONGEST_REASON = 2000  # characters


@dataclass(frozen=True)
class Gate:
    """Rules, all of which must pass, and the scoring they judge. Its digest freezes them. Raises
    BadGate without rules.

    `conditions` are those whose values make the cells of retained conditions. After `held_out_uses`
    trials an episode is spent, because choosing among candidates by it again and again fits them to
    it. `follows` names the plant's gate that this one replaces, and `because` says why. A gate that
    is known to accept anything declares itself `vacuous`, and says why.
    """

    rules: tuple[Rule, ...]
    scoring: Scoring
    conditions: tuple[str, ...] = ()
    held_out_uses: int | None = None
    follows: str | None = None
    because: str | None = None
    vacuous: bool = False

    def __post_init__(self) -> None:
        if not self.rules:
            raise BadGate("a gate without rules would pass everything")
        if not (
            np.isfinite(self.scoring.horizon_s) and self.scoring.horizon_s > 0.0
        ) or self.scoring.windows not in (FIRST, EVERY):
            raise BadGate(
                "a gate scores over a positive horizon, from the `first` window or from `every` one"
            )
        if self.held_out_uses is not None and self.held_out_uses < 1:
            raise BadGate("a held-out episode must be good for one use at least")
        if self.follows is not None and not is_digest(self.follows):
            raise BadGate(
                "follows must be the digest of the gate that this one takes the place of",
                field="follows",
            )
        if self.because is not None and not (
            seen(self.because) and len(self.because) <= LONGEST_REASON
        ):
            raise BadGate(
                f"because must say why, in {LONGEST_REASON} characters at most", field="because"
            )
        if (self.follows is not None or self.vacuous) and self.because is None:
            raise BadGate(
                "a gate that follows another, or is vacuous, says why in `because`", field="because"
            )

    @property
    def budget(self) -> int:
        """How many trials each held-out episode is good for."""
        return HELD_OUT_USES if self.held_out_uses is None else self.held_out_uses

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical document."""
        return digest_of(self.document())

    def document(self) -> dict[str, Json]:
        """The gate as JSON."""
        return {
            "schema": SCHEMA,
            "rules": [r.document() for r in self.rules],
            "scoring": self.scoring.document(),
            **({"conditions": list(self.conditions)} if self.conditions else {}),
            **({"held_out_uses": self.held_out_uses} if self.held_out_uses is not None else {}),
            **({"follows": self.follows} if self.follows is not None else {}),
            **({"because": self.because} if self.because is not None else {}),
            **({"vacuous": True} if self.vacuous else {}),
        }

    @staticmethod
    def from_document(document: Mapping[str, Json]) -> Gate:
        """Read a gate. Raises BadGate."""
        try:
            if document["schema"] != SCHEMA or not NEEDED <= set(document) <= NEEDED | OPTIONAL:
                more = ", ".join(sorted(OPTIONAL))
                raise BadGate(
                    (
                        f"a gate holds schema ({SCHEMA}), rules, scoring, and if it likes "
                        f"{more}, nothing else"
                    ),
                    hint=HOLDS,
                )
            values: Any = document
            if set(values["scoring"]) != {"horizon_s", "windows"}:
                raise BadGate(
                    "scoring holds horizon_s and windows, nothing else", field="scoring", hint=HOLDS
                )
            horizon_s = _read(values["scoring"], "horizon_s", float, "a number")
            return Gate(
                tuple(_rule(r) for r in _read(values, "rules", list, "a list")),
                Scoring(horizon_s, _read(values["scoring"], "windows", str, "a text")),
                tuple(_conditions(values)),
                _read(values, "held_out_uses", int, "a whole number", optional=True),
                _read(values, "follows", str, "a text", optional=True),
                _read(values, "because", str, "a text", optional=True),
                _read(values, "vacuous", bool, "true or false", optional=True) or False,
            )
        except KeyError as error:
            raise BadGate(f"a gate needs {error.args[0]!r}", hint=HOLDS) from error
        except (TypeError, ValueError, OverflowError) as error:
            raise BadGate(f"the gate cannot be read: {error!r}") from error


def _read(values: Any, name: str, kind: type, called: str, *, optional: bool = False) -> Any:
    """A field of the kind that it must have; a whole number may stand for a real one. Raises
    BadGate, KeyError."""
    value = values.get(name) if optional else values[name]
    if optional and value is None:
        return None
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise BadGate(f"{name} must be {called}", field=name, hint=HOLDS)
    return value


def _conditions(values: Any) -> list[str]:
    named = _read(values, "conditions", list, "a list of texts", optional=True) or []
    return [_read({"conditions": each}, "conditions", str, "a list of texts") for each in named]


def _rule(document: Mapping[str, Json]) -> Rule:
    values = dict(document)
    kind = rules().get(_read(values, "rule", str, "the name of a rule"))
    values.pop("rule")
    if kind is None:
        raise BadGate(
            f"the rule {document['rule']!r} is not known", hint=f"Rules are {', '.join(rules())}."
        )
    known = {f.name for f in fields(kind)}  # type: ignore[arg-type]
    if set(values) - known:
        raise BadGate(
            f"the rule {kind.name} has no {', '.join(sorted(set(values) - known))}",
            hint=f"It has {', '.join(sorted(known))}.",
        )
    require = values.pop("require", MEAN)
    if require not in (MEAN, BOUND):
        raise BadGate(f"the rule {kind.name} requires the {MEAN} or the {BOUND}", field="require")
    bounds = {name: _read(values, name, float, "a number") for name in values}
    if not all(np.isfinite(v) and v > 0.0 for v in bounds.values()):
        raise BadGate(f"the bounds of {kind.name} must be positive numbers")
    return kind(**bounds, require=require)  # type: ignore[call-arg]


def default_gate(horizon_s: float) -> Gate:
    """The gate of a plant that declares none: the mean rollout error below 0.98 of the incumbent's,
    and the one-step error no worse, over every window of each episode."""
    return Gate(
        (rules()["rollout_improves"](), rules()["one_step_no_worse"]()), Scoring(horizon_s, EVERY)
    )


@dataclass(frozen=True)
class Decision:
    """The decision of a gate on a candidate, against the incumbent that served at `generation`.

    It holds every figure, so that it can be recomputed, and the generation, so that it cannot be
    replayed after a move. `known` is what was known when the gate was declared
    (`trueup.gate.line`), `uses` how often each episode has been judged on, this time included, and
    `selection` the number of candidates and episodes that its own were selected from; decisions of
    earlier versions hold none of the three.
    """

    plant: str
    gate: str
    candidate: str
    incumbent: str
    generation: int
    episodes: tuple[str, ...]
    verdicts: tuple[Verdict, ...]
    figures: Mapping[str, Json]
    known: Mapping[str, Json]
    uses: tuple[int, ...]
    selection: Mapping[str, Json] | None = None

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
            "known": self.known,
            "uses": list(self.uses),
            **({} if self.selection is None else {"selection": dict(self.selection)}),
        }


def figures(score: Score) -> dict[str, Json]:
    """A score as JSON, one number for each episode; not-a-number is null."""
    return {"rollout": _numbers(score.rollout), "one_step": _numbers(score.one_step)}


def _numbers(values: np.ndarray) -> list[Json]:
    return [float(x) if np.isfinite(x) else None for x in values]
