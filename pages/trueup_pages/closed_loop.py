"""The page of a study in closed loop: how models track with a fixed planner, regime by regime."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trueup.diagnose.number_text import percent, short, unit
from trueup_pages.curves import Axis, Curve, colour, curves, key
from trueup_pages.drawing import Scale
from trueup_pages.rendering import render

BODY = "closedloop_body.html"
NAMES = {
    "nominal": "nominal plant",
    "shifted": "machine",
    "delayed": "machine, seen late",
    "reduced_authority": "machine, reduced authority",
}


def sentence(document: Mapping[str, Any]) -> str:
    """Returns the answer in a sentence or two."""
    regimes = {r["regime"]: r for r in document["regimes"]}
    regime = regimes.get("shifted") or document["regimes"][0]
    rows = [m for m in regime["models"] if m["tracking"] is not None]
    where = (
        "the nominal plant" if regime["machine"] == "nominal" else document["machine"]["stands_in"]
    )
    measure = unit(document["unit"])
    return f"{_best(rows, document['baseline'], where, measure)} {_envelope(document)}"


def _best(rows: Sequence[Mapping[str, Any]], baseline: str, where: str, measure: str) -> str:
    """Who tracks best in a regime."""
    if not rows:
        return f"Every run ran away on {where}."
    best = min(rows, key=lambda m: m["tracking"])
    error = f"mean squared error {short(best['tracking'])} {measure}"
    if len(rows) == 1:
        return f"{best['model']} tracks with a {error} on {where}."
    if best["model"] == baseline:
        return f"No other model tracks better than {baseline} on {where}: {error}."
    ends = best["change_ci95"]
    sure = f" (95 %: {_signed(ends[0])} to {_signed(ends[1])})" if ends else ""
    return (
        f"{best['model']} tracks best on {where}: {error}, {_signed(best['change'])} "
        f"against {baseline}{sure}."
    )


def _envelope(document: Mapping[str, Any]) -> str:
    """Whether runs left the envelope."""
    models = [(r["regime"], m) for r in document["regimes"] for m in r["models"]]
    if any(m["breaches"] is None for _, m in models):
        return "No envelope is declared, so breaches are not checked."
    left = [(r, m) for r, m in models if m["breaches"]["runs"]]
    if not left:
        return "No run left the envelope."
    runs = sum(m["breaches"]["runs"] for _, m in left)
    return (
        f"{runs} of {sum(r['runs'] * len(r['models']) for r in document['regimes'])} runs left the "
        f"envelope: {', '.join(dict.fromkeys(NAMES[r] for r, _ in left))}."
    )


def _signed(share: float) -> str:
    return f"{'+' if share > 0 else '−' if share < 0 else ''}{percent(abs(share))}"


def view(document: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of the page's body."""
    models = [m["model"] for m in document["regimes"][0]["models"]]
    kinds = {name: colour(i) for i, name in enumerate(models)}
    errors = [m["tracking"] for r in document["regimes"] for m in r["models"] if m["tracking"]]
    return {
        "d": document,
        "answer": sentence(document),
        "names": NAMES,
        "kinds": kinds,
        "scale": Scale(errors),
        "signed": _signed,
        "sweep": _sweep(document, kinds),
        "runs": [_run(r, document, kinds) for r in document["regimes"]],
    }


def report_page(document: Mapping[str, Any]) -> str:
    """Returns the study as one HTML file that loads nothing else."""
    title = f"Closed loop of {document['plant']}"
    return render("study_report.html", title=title, body=BODY, **view(document))


def _sweep(document: Mapping[str, Any], kinds: Mapping[str, str]) -> Mapping[str, Any] | None:
    """Tracking over delay."""
    if not document["sweep"]:
        return None
    lines = []
    for name, kind in kinds.items():
        rows = [s for s in document["sweep"] if s["model"] == name]
        for what, dashed in (("tracking", False), ("stamped", True)):
            points = tuple((float(s["delay_ticks"]), s[what]) for s in rows)
            lines.append(Curve(f"{name}{', brought forward' * dashed}", kind, points, dashed))
    across, along = Axis("delay [ticks]"), Axis(f"mean squared error [{unit(document['unit'])}]")
    return {"picture": curves(lines, across, along, "tracking over delay"), "key": key(lines)}


def _run(
    regime: Mapping[str, Any], document: Mapping[str, Any], kinds: Mapping[str, str]
) -> dict[str, Any]:
    """One run of each model in a regime: the first joint and the first command."""
    tick_s, drawn = document["reference"]["tick_s"], document["reference"]["drawn"]
    positions = [Curve("reference", "ink", _over(drawn[0], tick_s), dashed=True)]
    issued, applied = [], []
    for m in regime["models"]:
        kind, run = kinds[m["model"]], m["drawn"]
        # the position after a tick is compared with the reference at its beginning
        positions.append(Curve(m["model"], kind, _over(run["positions"][0], tick_s)))
        issued.append(
            Curve(f"{m['model']}, issued", kind, _over(run["issued"][0], tick_s), dashed=True)
        )
        applied.append(Curve(f"{m['model']}, applied", kind, _over(run["applied"][0], tick_s)))
    time, name = Axis("time [s]"), NAMES[regime["regime"]]
    position, command = (
        Axis(f"{c['name']} [{unit(c['unit'])}]" if c["unit"] else c["name"])
        for c in (document["reference"]["channels"][what] for what in ("position", "command"))
    )
    return {
        "name": name,
        "positions": curves(positions, time, position, f"positions on the {name}"),
        "commands": curves([*issued, *applied], time, command, f"commands on the {name}"),
        "key": key([positions[0], *positions[1:]]),
    }


def _over(values: Sequence[float | None], tick_s: float) -> tuple[tuple[float, float | None], ...]:
    return tuple((i * tick_s, x) for i, x in enumerate(values))
