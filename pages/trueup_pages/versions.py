"""What pages show of versions: each in a few words, what differs between several, and the errors by
which gates judged them, over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from trueup.diagnose.number_text import short
from trueup.diagnose.summary_text import name
from trueup_pages.time_chart import Point, chart

MISSING = "–"


def summary(manifest: Mapping[str, Any]) -> dict[str, str]:
    """A version in words, from its manifest: its numbers, its effects and where it came from."""
    predictor, provenance = manifest.get("predictor", {}), manifest.get("provenance", {})
    described: dict[str, str] = {}
    numbers = predictor.get("parameters") or manifest["plant"]["document"]["nominal"].get(
        "parameters", {}
    )
    if isinstance(numbers, dict):
        described |= {
            f"parameter {key}": short(value)
            for key, value in numbers.items()
            if isinstance(value, int | float)
        }
    for effect in predictor.get("effects", []):
        described |= {
            f"{name(effect)}, {key}": short(value) for key, value in effect["parameters"].items()
        }
    if predictor.get("features"):
        described["features"] = ", ".join(predictor["features"])
    document = provenance.get("configuration", {}).get("document", {})
    described["origin"] = str(provenance.get("origin") or document.get("method", MISSING))
    described["code"] = str(provenance.get("code", {}).get("sha256", MISSING))[:16]
    read = document.get("episodes")
    described["episodes"] = str(len(read)) if read else MISSING
    return described


def differences(versions: Sequence[Mapping[str, str]]) -> list[dict[str, Any]]:
    """What several versions are in words, as rows of one property each."""
    rows = []
    for what in dict.fromkeys(key for described in versions for key in described):
        values = [described.get(what, MISSING) for described in versions]
        rows.append({"what": what, "values": values, "differs": len(set(values)) > 1})
    return rows


@dataclass(frozen=True, slots=True)
class Judged:
    """The decisions of one gate that name some versions: a row for each, and their errors over
    time."""

    gate: str
    horizon_s: float
    windows: str
    rows: Sequence[Mapping[str, Any]]
    drawn: Markup


def judged(
    plant: str,
    decisions: Sequence[Any],
    numbers: Mapping[str, int],
    gates: Mapping[str, Mapping[str, Any]],
) -> list[Judged]:
    """The decisions (`digest`, `gate`, `candidate`, `incumbent`, `accepted`, `document`,
    `created_at`) that name versions, by gate, since errors of two gates cannot be compared.
    `numbers` are those of the versions by digest, and `gates` the documents of the gates."""
    parts = []
    for gate in dict.fromkeys(d.gate for d in decisions):
        rows, points = [], []
        for d in sorted((d for d in decisions if d.gate == gate), key=lambda d: d.created_at):
            errors = {which: _error(d.document, which) for which in ("candidate", "incumbent")}
            rows.append({"decision": d, **errors})
            for which, artifact in (("candidate", d.candidate), ("incumbent", d.incumbent)):
                error = errors[which]
                if artifact not in numbers or error is None:
                    continue
                number, page = numbers[artifact], f"/plants/{plant}/decisions/{d.digest}"
                part, kind = _part(which, accepted=d.accepted)
                label = f"version {number} {part}: {short(error)}"
                points.append(Point(d.created_at, error, str(number), kind, label, page))
        scoring = gates[gate]["scoring"]
        drawn = chart(points, "error by which each version was judged, over time")
        parts.append(Judged(gate, scoring["horizon_s"], scoring["windows"], rows, drawn))
    return parts


def _part(which: str, *, accepted: bool) -> tuple[str, str]:
    """In which part a version was judged, in words, and the kind of its colour."""
    if which == "incumbent":
        return "as incumbent", "left"
    return ("as candidate, accepted", "good") if accepted else ("as candidate, rejected", "bad")


def _error(document: Mapping[str, Any], which: str) -> float | None:
    """The mean rollout error over the episodes of a decision, None where it is not recorded."""
    each = document.get("figures", {}).get(which, {}).get("rollout", [])
    fine = [x for x in each if isinstance(x, int | float)]
    return sum(fine) / len(fine) if fine and len(fine) == len(each) else None
