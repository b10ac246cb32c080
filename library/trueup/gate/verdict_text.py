"""What a decision's verdicts say in words, and whether its recordings settle them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trueup.diagnose.number_text import short


def reasons(verdicts: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """The rules that refused a candidate, each with its reason in words."""
    return [(str(v["rule"]), _reason(v)) for v in verdicts if not v["passed"]]


def can_be_settled(verdicts: Sequence[Mapping[str, Any]]) -> bool:
    """Whether more recordings could turn a refusal round: no rule refuses with an interval that
    lies beyond its bound."""
    refused = [v for v in verdicts if not v["passed"]]
    return bool(refused) and all(is_unsettled(v) for v in refused)


def is_unsettled(verdict: Mapping[str, Any]) -> bool:
    """Whether the 95 % interval of the ratio of errors holds the rule's bound, so that chance in
    the choice of recordings may have made the verdict; not where something else refused."""
    bound, interval = _bound(verdict), verdict.get("ci95")
    if bound is None or interval is None or not interval[0] <= bound <= interval[1]:
        return False
    is_beyond = verdict["ratio"] >= bound or verdict.get("require") == "bound"
    return bool(verdict["passed"]) or is_beyond


def unsettled_words(verdict: Mapping[str, Any]) -> str:
    """That a verdict is not settled, and by which figures; empty where it is."""
    if not is_unsettled(verdict):
        return ""
    low, high = verdict["ci95"]
    return (
        f"these recordings do not settle it: the 95 % interval of the ratio, {short(low)} to "
        f"{short(high)}, includes the bound {short(_bound(verdict))}"
    )


def _reason(verdict: Mapping[str, Any]) -> str:
    bound = _bound(verdict)
    if bound is None or (verdict["ratio"] <= bound and verdict.get("require") != "bound"):
        return str(verdict["because"])  # something else than the error refused
    text = (
        f"the error is {short(verdict['ratio'])} times the incumbent's, and {short(bound)} times "
        "is allowed"
    )
    remark = unsettled_words(verdict)
    return f"{text}; {remark}" if remark else text


def _bound(verdict: Mapping[str, Any]) -> float | None:
    """What a rule allows the ratio of errors to be; None where nothing was compared."""
    ratio, value, threshold = (verdict.get(name) for name in ("ratio", "value", "threshold"))
    if not ratio or not value or threshold is None:
        return None
    return float(threshold * ratio / value)
