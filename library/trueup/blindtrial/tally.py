"""Tally: answers held against opened labels: how often right, how often the truth was among the
alternatives, what the intervals cover.

exact     the answer names the hidden composition and no other; an effect of the same law on every
          log, or one that no measurement on this plant tells from it and the answer lists beside
          it, counts as named
in set    it is named or among the listed alternatives
outside   a machine with something beyond the catalogue is answered by `unknown_effect`
none      a machine without effects is answered by `parameters_only`, or by `no_gap` where its
          numbers are the nominal ones
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueup.blindtrial.lot import spelled
from trueup.canonical import Json
from trueup.diagnose.indistinguishable import ALIASES
from trueup.model.effect import effects

BY_CHANCE = (
    0.0025  # that an honest diagnosis names an effect where there is none, and it is the bait
)
IMPROBABLE = 0.02
ONE_SIDED = 1.645  # standard errors
# Numbers that both simulators mean alike, where that is not an effect's first alone: the laws
# behind the others differ on purpose, and what is counted has no interval worth the name.
ALIKE: Mapping[str, tuple[str, ...]] = {
    "thermal_derating": ("time_constant",),
    "cogging": ("pitch",),
    "quadratic_gain": ("odd", "even"),
    "elastic_transmission": (),
    "sensor_quantization": (),
    "dropped_frames": (),
}


@dataclass(frozen=True, slots=True)
class Answer:
    """What the diagnosing process said of one case: its report, or a problem; and how long it took
    [s]."""

    report: Mapping[str, Any] | None
    problem: str | None
    seconds: float

    @property
    def verdict(self) -> str:
        """The report's, or `refused`."""
        return str(self.report["verdict"]) if self.report else "refused"

    @property
    def named(self) -> frozenset[str]:
        """The answer's effects."""
        return _folded(self.report["effects"]) if self.report else frozenset()

    @property
    def others(self) -> set[frozenset[str]]:
        """The listed alternatives."""
        return (
            {_folded(names) for names in self.report["indistinguishable"]} - {self.named}
            if self.report
            else set()
        )


def _folded(of: Iterable[str | Mapping[str, Any]]) -> frozenset[str]:
    """Effects of a label or a report as they are compared: on the log of one joint, effects of one
    law are one."""
    found = set()
    for at in of:
        name, _, joint = (
            at.partition(" at ") if isinstance(at, str) else (at["effect"], "", at.get("joint", ""))
        )
        found.add(
            spelled(name, joint)
            if joint
            else effects()[name].same_as or name
            if name in effects()
            else name
        )
    return frozenset(found)


def _are_twins(differing: frozenset[str]) -> bool:
    """Whether two answers differ in nothing but twins at one joint."""
    parts = [name.partition(" at ") for name in differing]
    return (
        len({joint for _, _, joint in parts}) == 1
        and frozenset(name for name, _, _ in parts) in ALIASES
    )


def judge(label: Mapping[str, Any], answer: Answer) -> dict[str, Json]:
    """One trial: was the answer exact, was the truth in its set, how many alternatives did it
    leave."""
    truth, named, others = _folded(label["effects"]), answer.named, answer.others
    if label["kind"] == "none":
        fine = {"parameters_only"} if label["moved"] else {"parameters_only", "no_gap"}
        exact = in_set = answer.verdict in fine and not named
    elif label["kind"] == "outside":
        exact = in_set = answer.verdict == "unknown_effect"
    else:
        claimed = answer.verdict == "effect"
        exact = claimed and (named == truth or (truth in others and _are_twins(named ^ truth)))
        in_set = claimed and (exact or truth in others)
    taken = bool(label["bait"]) and named >= _folded([label["bait"]])
    excess = {o for o in others - {truth} if not _are_twins(o ^ named)}
    return {"exact": exact, "in_set": in_set, "alternatives": len(excess), "bait_taken": taken}


def intervals(label: Mapping[str, Any], answer: Answer) -> list[dict[str, Any]]:
    """Of a rightly named composition each comparable number: of what, the hidden value, the
    estimate, and whether its interval holds."""
    if (
        label["kind"] == "outside"
        or answer.report is None
        or answer.verdict not in ("effect", "parameters_only")
    ):
        return []
    if answer.named != _folded(label["effects"]):
        return []
    found = []
    for entry in answer.report["effects"]:
        name = entry["effect"]
        true: Mapping[str, float] = next(
            (v for n, v in label["effects"].items() if _folded([entry]) == _folded([n])), {}
        )
        compared = [
            n
            for n in ALIKE.get(name, (effects()[name].params[0].name,))
            if n in true and n in entry["estimate"]
        ]
        found += [_held(name, n, true[n], entry["estimate"][n]) for n in compared]
    own = label["parameters"]  # of a robot the log shows sums of them
    return found + [
        _held("", n, own[n], p) for n, p in answer.report["parameters"].items() if n in own
    ]


def _held(of: str, number: str, true: float, estimate: Mapping[str, Any]) -> dict[str, Any]:
    low, high = estimate["ci95"]
    return {
        "of": of,
        "number": number,
        "true": true,
        "value": estimate["value"],
        "ci95": [low, high],
        "holds": low <= true <= high,
    }


def bound(label: Mapping[str, Any], answer: Answer) -> bool | None:
    """Whether the bound on a hidden single effect that was not named holds; None where there is
    none."""
    if answer.report is None or len(label["effects"]) != 1 or answer.verdict == "effect":
        return None
    ((name, numbers),) = label["effects"].items()
    for entry in answer.report["excluded"]:
        if _folded([entry]) == _folded([name]) and entry["parameter"] in numbers:
            size = abs(numbers[entry["parameter"]])
            if not size:
                return None  # the other of its numbers is hidden
            return (
                bool(size <= entry["below"]) if "below" in entry else bool(size >= entry["above"])
            )
    return None


def tally(rows: Sequence[Mapping[str, Any]], answers: Sequence[Answer]) -> dict[str, Json]:
    """The trials together. `rows` hold each trial's label and judgement, and `closed`, what was
    closed on recordings only for measuring."""
    kinds: dict[str, Json] = {}
    for kind in dict.fromkeys(r["label"]["kind"] for r in rows):
        of = [r for r in rows if r["label"]["kind"] == kind]
        kinds[kind] = {
            "n": len(of),
            "exact": _rate(r["exact"] for r in of),
            "in_set": _rate(r["in_set"] for r in of),
            "alternatives": float(np.mean([r["alternatives"] for r in of])),
        }
    checks = [x for r in rows for x in r["intervals"]]
    bounds = [
        b for r, a in zip(rows, answers, strict=True) if (b := bound(r["label"], a)) is not None
    ]
    baits = [r for r in rows if r["label"]["bait"]]
    taken = sum(r["bait_taken"] for r in baits)
    return {
        "kinds": kinds,
        "confusion": _confusion(rows),
        "trust": _trust(rows),
        "coverage": {
            "effects": _rate(x["holds"] for x in checks if x["of"]),
            "parameters": _rate(x["holds"] for x in checks if not x["of"]),
            "bounds": _rate(bounds),
        },
        "closed": _closed(rows),
        "refused": sum(a.report is None for a in answers),
        "leak": {"baits": len(baits), "taken": taken, "void": _improbable(taken, len(baits))},
        "seconds": {
            "median": float(np.median([a.seconds for a in answers])),
            "max": float(max(a.seconds for a in answers)),
        },
    }


def _improbable(taken: int, baits: int) -> bool | None:
    """Whether so many baits cannot have been answered by chance; None where there were none."""
    chance = sum(
        math.comb(baits, k) * BY_CHANCE**k * (1.0 - BY_CHANCE) ** (baits - k)
        for k in range(taken, baits + 1)
    )
    return bool(taken and chance < IMPROBABLE) if baits else None


def _confusion(rows: Sequence[Mapping[str, Any]]) -> list[Json]:
    """How often which truth was answered how, faint ones apart."""
    counts = Counter(_where_apart(r) for r in rows if r["label"]["kind"] != "faint")
    return [
        {"truth": truth, "answer": answer, "n": n} for (truth, answer), n in sorted(counts.items())
    ]


def _where_apart(row: Mapping[str, Any]) -> tuple[str, str]:
    """Truth and answer of a trial in words, joints left out where they are right, and said to be
    others where they are not."""
    truth, answer = (
        _words(_folded(row["label"]["effects"]), row["label"]["kind"]),
        str(row["answer"]),
    )
    alike = _placeless(truth) == _placeless(answer)
    return _placeless(truth), _placeless(answer) + (
        ", at another joint" if alike and truth != answer else ""
    )


def _placeless(words: str) -> str:
    return " + ".join(sorted(part.partition(" at ")[0] for part in words.split(" + ")))


def _words(names: frozenset[str], kind: str) -> str:
    return (
        "outside the catalogue" if kind == "outside" else " + ".join(sorted(names)) or "no effect"
    )


def answer_words(answer: Answer) -> str:
    """An answer as the confusion matrix names it."""
    if answer.verdict == "effect":
        return " + ".join(sorted(answer.named))
    return {"unknown_effect": "outside the catalogue"}.get(
        answer.verdict, "no effect" if answer.verdict != "refused" else "refused"
    )


def _trust(rows: Sequence[Mapping[str, Any]]) -> list[Json]:
    """Of each answer that was given: how often it was right, and how often at least, with 95 %
    confidence."""
    found: list[Json] = []
    for answer in sorted({_placeless(r["answer"]) for r in rows}):
        of = [
            bool(r["exact"])
            for r in rows
            if _placeless(r["answer"]) == answer and r["label"]["kind"] != "faint"
        ]
        if of:
            found.append(
                {
                    "answer": answer,
                    "n": len(of),
                    "right": sum(of),
                    "at_least": lower(sum(of), len(of)),
                }
            )
    return found


def _closed(rows: Sequence[Mapping[str, Any]]) -> Json:
    """What was closed where an effect was hidden, and how far the report was off."""
    kept = [r for r in rows if r["closed"] is not None and r["label"]["kind"] in ("single", "pair")]
    if not kept:
        return None
    closed = [r["closed"] for r in kept]
    off = [
        abs(r["closed"] - r["reported_closed"]) for r in kept if r["reported_closed"] is not None
    ]
    return {
        "n": len(kept),
        "median": float(np.median(closed)),
        "worst_tenth": float(np.quantile(closed, 0.1)),
        "reported_off_p90": float(np.quantile(off, 0.9)) if off else None,
    }


def _rate(found: Iterable[Any]) -> Json:
    values = [bool(x) for x in found]
    return {
        "n": len(values),
        "share": float(np.mean(values)) if values else None,
        "at_least": lower(sum(values), len(values)),
    }


def lower(right: int, n: int) -> float:
    """The share that at least is right, with 95 % confidence.

    Source: E. B. Wilson, Journal of the American Statistical Association 22 (1927).
    """
    if not n:
        return 0.0
    z2, share = ONE_SIDED**2, right / n
    return max(
        0.0,
        (share + z2 / 2 / n - ONE_SIDED * math.sqrt(share * (1 - share) / n + z2 / 4 / n**2))
        / (1 + z2 / n),
    )
