"""Scoring: answers compared with opened labels. How often an answer is right, how often the truth
is among its alternatives, what its intervals cover.

exact     the answer names the hidden composition and no other; an effect of the same law on every
          log, or one that no measurement on this plant tells from it and the answer lists beside
          it, counts as named
in set    it is named or among the listed alternatives
outside   a machine with something beyond the catalogue is answered by `unknown_effect`
none      a machine without effects is answered by `parameters_only`, or by `no_gap` where its
          numbers are the nominal ones
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from trueup.blindtrial.specification import spelled
from trueup.canonical import Json
from trueup.diagnose.indistinguishable import ALIASES
from trueup.model.effect import effects

# The chance that an honest diagnosis of a machine without effects names one, and it is the decoy.
BY_CHANCE = 0.0025
IMPROBABLE = 0.02
CONFIDENCE = 0.95  # of a lower bound
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
    """The diagnosing process's answer to one case: its report, or a problem; and how long it took
    [s]."""

    report: Mapping[str, Any] | None
    problem: str | None
    seconds: float

    @property
    def verdict(self) -> str:
        """The report's verdict, or `refused` where there is no report."""
        return str(self.report["verdict"]) if self.report else "refused"

    @property
    def named(self) -> frozenset[str]:
        """The effects that the answer names."""
        return _folded(self.report["effects"]) if self.report else frozenset()

    @property
    def others(self) -> set[frozenset[str]]:
        """The alternative compositions that the answer lists."""
        return (
            {_folded(names) for names in self.report["indistinguishable"]} - {self.named}
            if self.report
            else set()
        )


def _folded(of: Iterable[str | Mapping[str, Any]]) -> frozenset[str]:
    """Effects of a label or a report as they are compared: on the log of one joint, effects of one
    law count as one."""
    names = set()
    for entry in of:
        if isinstance(entry, str):
            name, _, joint = entry.partition(" at ")
        else:
            name, joint = entry["effect"], entry.get("joint", "")
        if joint:
            names.add(spelled(name, joint))
        else:
            names.add((effects()[name].same_as or name) if name in effects() else name)
    return frozenset(names)


def _are_indistinguishable(differing: frozenset[str]) -> bool:
    """Whether two answers differ in nothing but indistinguishable effects at one joint."""
    parts = [name.partition(" at ") for name in differing]
    return (
        len({joint for _, _, joint in parts}) == 1
        and frozenset(name for name, _, _ in parts) in ALIASES
    )


def score_answer(label: Mapping[str, Any], answer: Answer) -> dict[str, Json]:
    """The score of one trial: whether the answer is exact, whether the truth is in its set, how
    many wrong alternatives it leaves, and whether it took the decoy."""
    truth, named, others = _folded(label["effects"]), answer.named, answer.others
    if label["kind"] == "none":
        fine = {"parameters_only"} if label["moved"] else {"parameters_only", "no_gap"}
        exact = in_set = answer.verdict in fine and not named
    elif label["kind"] == "outside":
        exact = in_set = answer.verdict == "unknown_effect"
    else:
        claimed = answer.verdict == "effect"
        exact = claimed and (
            named == truth or (truth in others and _are_indistinguishable(named ^ truth))
        )
        in_set = claimed and (exact or truth in others)
    taken = bool(label["bait"]) and named >= _folded([label["bait"]])
    excess = {o for o in others - {truth} if not _are_indistinguishable(o ^ named)}
    return {"exact": exact, "in_set": in_set, "alternatives": len(excess), "bait_taken": taken}


def score_intervals(label: Mapping[str, Any], answer: Answer) -> list[dict[str, Any]]:
    """Each comparable number of a rightly named composition: the effect it is of, its hidden value,
    its estimate, and whether the estimate's interval holds. Empty for other answers."""
    if (
        label["kind"] == "outside"
        or answer.report is None
        or answer.verdict not in ("effect", "parameters_only")
    ):
        return []
    if answer.named != _folded(label["effects"]):
        return []
    scored = []
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
        scored += [_held(name, n, true[n], entry["estimate"][n]) for n in compared]
    own = label["parameters"]  # of a robot the log shows sums of them
    return scored + [
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


def bound_holds(label: Mapping[str, Any], answer: Answer) -> bool | None:
    """Whether the answer's bound on a single hidden effect that it does not name holds; None where
    there is no such bound."""
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


def summarise(rows: Sequence[Mapping[str, Any]], answers: Sequence[Answer]) -> dict[str, Json]:
    """The scores of all trials together, as fields of the report. Each of `rows` holds a trial's
    label and score, and `closed`, the share of the gap that was closed on its test recordings."""
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
        b
        for r, a in zip(rows, answers, strict=True)
        if (b := bound_holds(r["label"], a)) is not None
    ]
    decoys = [r for r in rows if r["label"]["bait"]]
    taken = sum(r["bait_taken"] for r in decoys)
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
        "leak": {"baits": len(decoys), "taken": taken, "void": _improbable(taken, len(decoys))},
        "seconds": {
            "median": float(np.median([a.seconds for a in answers])),
            "max": float(max(a.seconds for a in answers)),
        },
    }


def _improbable(taken: int, decoys: int) -> bool | None:
    """Whether `taken` of the decoys cannot have been answered by chance; None where there are
    none."""
    if not decoys:
        return None
    chance = binomtest(taken, decoys, BY_CHANCE, alternative="greater").pvalue
    return bool(chance < IMPROBABLE)


def _confusion(rows: Sequence[Mapping[str, Any]]) -> list[Json]:
    """The confusion matrix as a list: how often each truth got each answer, without faint ones."""
    counts = Counter(_truth_and_answer(r) for r in rows if r["label"]["kind"] != "faint")
    return [
        {"truth": truth, "answer": answer, "n": n} for (truth, answer), n in sorted(counts.items())
    ]


def _truth_and_answer(row: Mapping[str, Any]) -> tuple[str, str]:
    """Truth and answer of a trial in words, without joints. An answer that is right but for the
    joint ends in "at another joint"."""
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
    """For each answer how often it was right, and the share that is right at least, with 95 %
    confidence."""
    trust: list[Json] = []
    for answer in sorted({_placeless(r["answer"]) for r in rows}):
        of = [
            bool(r["exact"])
            for r in rows
            if _placeless(r["answer"]) == answer and r["label"]["kind"] != "faint"
        ]
        if of:
            trust.append(
                {
                    "answer": answer,
                    "n": len(of),
                    "right": sum(of),
                    "at_least": lower_bound(sum(of), len(of)),
                }
            )
    return trust


def _closed(rows: Sequence[Mapping[str, Any]]) -> Json:
    """The share of the gap that was closed where an effect was hidden, and how far the report's own
    figure was off."""
    corrected = [
        r for r in rows if r["closed"] is not None and r["label"]["kind"] in ("single", "pair")
    ]
    if not corrected:
        return None
    closed = [r["closed"] for r in corrected]
    off = [
        abs(r["closed"] - r["reported_closed"])
        for r in corrected
        if r["reported_closed"] is not None
    ]
    return {
        "n": len(corrected),
        "median": float(np.median(closed)),
        "worst_tenth": float(np.quantile(closed, 0.1)),
        "reported_off_p90": float(np.quantile(off, 0.9)) if off else None,
    }


def _rate(outcomes: Iterable[Any]) -> Json:
    """How many outcomes there are, the share that is true, and that share's lower bound."""
    values = [bool(x) for x in outcomes]
    return {
        "n": len(values),
        "share": float(np.mean(values)) if values else None,
        "at_least": lower_bound(sum(values), len(values)),
    }


def lower_bound(right: int, n: int) -> float:
    """The lower bound of a share of which `right` of `n` were observed, with 95 % confidence.

    Source: E. B. Wilson, Journal of the American Statistical Association 22 (1927).
    """
    if not n:
        return 0.0
    observed = binomtest(right, n, alternative="greater")
    return float(observed.proportion_ci(CONFIDENCE, method="wilson").low)
