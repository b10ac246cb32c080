"""The page of a study in open loop: how far rollouts go astray, beside the bound on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.diagnose.number_text import short
from trueup_pages.curves import Axis, Curve, colour, curves, key
from trueup_pages.rendering import render

BODY = "openloop_body.html"
PREMISES = {
    "equal_starts": "both rollouts start from the same state",
    "defect_holds_where_it_goes": "the one-step error stays within ε along the whole rollout",
    "lipschitz": "errors grow by no more than L and ε allow",
    "state_observed": "the whole state is observed",
    "one_step_length": "all steps have one length",
    "no_memory": "the next state depends on the last one alone",
}


def sentence(document: Mapping[str, Any]) -> str:
    """Returns the answer in a sentence or two."""
    longest = _longest(document)
    if longest is None:
        return "No recording is as long as the shortest of the horizons."
    rows = {
        m["model"]: next(e for e in m["errors"] if e["steps"] == longest)
        for m in document["models"]
    }
    best = min(
        rows, key=lambda name: rows[name]["mean"] if rows[name]["mean"] is not None else 1e300
    )
    if rows[best]["mean"] is None:
        return f"Every rollout runs away within {longest} steps."
    text = f"After {longest} steps {best} is off by {short(rows[best]['mean'])} on average"
    if len(rows) > 1:
        text = f"After {longest} steps {best} is off least: {short(rows[best]['mean'])} on average"
    return f"{text}. {_bound(document)}"


def _longest(document: Mapping[str, Any]) -> int | None:
    """The longest horizon that some recording reaches."""
    reached = [e["steps"] for m in document["models"] for e in m["errors"] if e["windows"]]
    return max(reached) if reached else None


def _bound(document: Mapping[str, Any]) -> str:
    """Whether the bound held, and which premises do not hold."""
    above = [m["model"] for m in document["models"] if any(e["exceeds"] for e in m["errors"])]
    broken = dict.fromkeys(
        PREMISES[p["premise"]]
        for p in (*document["premises"], *(p for m in document["models"] for p in m["premises"]))
        if p["holds"] is False
    )
    held = (
        f"Errors of {', '.join(above)} exceed the bound" if above else "No error exceeds the bound"
    )
    if not broken:
        return f"{held}; the data break none of its premises."
    return f"{held}; these of its premises do not hold on the data: {'; '.join(broken)}."


def view(document: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of the page's body."""
    kinds = {m["model"]: colour(i) for i, m in enumerate(document["models"])}
    lines = []
    for m in document["models"]:
        for what, dashed in (("mean", False), ("bound", True)):
            points = tuple((float(e["steps"]), e[what]) for e in m["errors"])
            name = f"{m['model']}, {'bound' if dashed else 'mean error'}"
            lines.append(Curve(name, kinds[m["model"]], points, dashed))
    across, along = Axis("steps", logarithmic=True), Axis("error, in scales", logarithmic=True)
    return {
        "d": document,
        "answer": sentence(document),
        "kinds": kinds,
        "premises": PREMISES,
        "picture": curves(lines, across, along, "error over steps, beside its bound"),
        "key": key(lines),
    }


def report_page(document: Mapping[str, Any]) -> str:
    """Returns the study as one HTML file that loads nothing else."""
    title = f"Open loop of {document['plant']}"
    return render("study_report.html", title=title, body=BODY, **view(document))
