"""The page of a diagnosis: the values that its template needs, and the whole as one file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from markupsafe import Markup

from trueup.diagnose import answer_table, number_text, summary_text, summary_warnings
from trueup.diagnose.number_text import percent
from trueup_pages import consistency, drawing
from trueup_pages.rendering import render

ROWS = 14  # most compositions in the ranking
MODELS = (
    {"key": "nominal", "label": "nominal", "kind": "nominal"},
    {"key": "corrected", "label": "corrected", "kind": "corrected"},
)
STILL_POINTS = 400  # of a line that is drawn without a script
INSEPARABLE = "the evidence cannot separate what is above this line"
NOT_ENOUGH = "none explains the gap: what is above this line comes nearest"
ALONE = (
    "everything below this line is worse than the answer, or better by less than its "
    "numbers must earn"
)

ALONE_BY = {"nominal": "nominal model", "fitted": "refitted parameters alone"}


def report_page(
    report: Mapping[str, Any],
    figures: Mapping[str, Any] | None,
    command_file: str | None = "next_experiment.csv",
    names: Mapping[str, str] = summary_text.UNNAMED,
) -> str:
    """Returns a diagnosis as one HTML file that loads nothing else; `names` are those of recordings
    by digest."""
    return render("report.html", **view(report, figures, command_file, names=names))


def view(
    report: Mapping[str, Any],
    figures: Mapping[str, Any] | None,
    command_file: str | None,
    episode_url: Callable[[str], str] | None = None,
    step: object = None,
    names: Mapping[str, str] = summary_text.UNNAMED,
) -> dict[str, Any]:
    """Returns the values of `diagnosis_body.html`; `step` is what to do next, on a page of a
    service; `names` are those of recordings by digest."""
    where = report["where"]
    return {
        "d": report,
        "faults": summary_text.faults(report, names),
        "warned": summary_warnings.warnings(report, names),
        "recording_name": partial(summary_text.recording_name, names=names),
        "answer": summary_text.sentence(report),
        "title": answer_table.title(report),
        "rows": answer_table.rows(report),
        "left_over": answer_table.left_over(report),
        "equations": answer_table.equations(report),
        "estimated": consistency.of_diagnosis(report, names),
        "figures": figures,
        **recordings_of(figures, MODELS),
        "parts": summary_text.waterfall(report),
        "ranked": ranking(report),
        "listed": _listed,
        "command_file": command_file,
        "episode_url": episode_url,
        "step": step,
        "region_rows": [
            (
                r["region"],
                r["share"],
                (f"{percent(r['share'])} of the residual in {percent(r['of_time'])} of the time"),
            )
            for r in where["regions"]
        ],
        "port_rows": [
            (
                p["port"],
                p["share"],
                f"{percent(p['share'])} by {summary_text.name(p['by'])}",
            )
            for p in where["ports"]
        ],
        "band_rows": [
            (
                b["band"],
                b["share"],
                f"{percent(b['share'])}, {percent(b['of_motion'])} of the motion",
            )
            for b in where["bands"]
        ],
        "channel_rows": [
            (c["channel"], c["share"], percent(c["share"])) for c in where["channels"]
        ],
        "joint_rows": [
            (
                j["joint"],
                j["force"],
                (
                    f"{percent(j['force'])} of the residual force, "
                    f"{percent(j['acceleration'])} of the acceleration"
                ),
            )
            for j in where.get("joints", [])
        ],
    }


def recordings_of(
    drawn: Mapping[str, Any] | None, models: Sequence[Mapping[str, str]]
) -> dict[str, Any]:
    """Returns the values of `recordings.html`, and the colours of maps.

    Each of `models` has a `key`, a `label`, and the `kind` of its line.
    """
    if not drawn or not drawn["episodes"]:
        return {"recordings": None, "data": "", "still": 1, "ramp": ramp()}
    recordings = {"horizon_s": drawn["horizon_s"], "models": models, "episodes": drawn["episodes"]}
    data = Markup(_embedded({"models": models, "episodes": drawn["episodes"]}))
    still = max(1, math.ceil(len(drawn["episodes"][0]["t_s"]) / STILL_POINTS))
    return {"recordings": recordings, "data": data, "still": still, "ramp": ramp()}


def ranking(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Returns compositions as rows.

    First come the answer and those that the evidence cannot separate from it, then, below a line,
    the others, the nearest first.
    """
    rows = report["evidence"]["hypotheses"]
    answers = [h for h in rows if h.get("answer")]
    least = answers[0]["validation"] if answers else None
    inside = sorted(
        (h for h in rows if h.get("in_set")), key=lambda h: (not h.get("answer"), h["validation"])
    )
    rest = sorted(
        (h for h in rows if not h.get("in_set") and h["validation"] is not None),
        key=lambda h: h["validation"],
    )
    bare = [h for h in rest if not h["effects"]]
    shown = [
        *inside,
        *[h for h in rest if h["effects"]][: max(ROWS - len(inside) - len(bare), 0)],
        *bare,
    ]
    shown = inside + sorted(shown[len(inside) :], key=lambda h: h["validation"])
    base = least or min((h["validation"] for h in shown if h["validation"]), default=1.0)
    scale = drawing.Scale([math.sqrt(h["validation"] / base) for h in shown if h["validation"]])
    enough = report["verdict"] != "unknown_effect"
    called = "the answer" if enough else "the nearest, and not enough"
    line = NOT_ENOUGH if not enough else ALONE if len(inside) == 1 else INSEPARABLE
    ranked = []
    for at, h in enumerate(shown):
        value = h["validation"]
        worse = h.get("worse_ci95")
        ends = (
            [math.sqrt(max(1.0 + w / base, 0.0)) for w in worse]
            if worse and None not in worse and least is not None and not h.get("answer")
            else None
        )
        closer = least is not None and value < least and not h.get("in_set")
        ranked.append(
            {
                "name": summary_text.composition(h["effects"], ALONE_BY[h["parameters"]]),
                "times": math.sqrt(value / base),
                "in_set": bool(h.get("in_set")),
                "note": called
                if h.get("answer")
                else "fits closer, by less than more numbers must earn"
                if closer
                else "",
                "drawn": drawing.interval(
                    scale,
                    math.sqrt(value / base),
                    ends,
                    "answer"
                    if h.get("in_set")
                    else "nominal"
                    if h["parameters"] == "nominal"
                    else "other",
                ),
                "divide": line if at == len(inside) and inside else "",
            }
        )
    return ranked


def _embedded(value: object) -> str:
    """Returns JSON for a script element, in which nothing can end that element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def ramp() -> Markup:
    """Draws the colours of maps, from the lowest to the highest."""
    cells = "".join(
        f'<rect class="h{i}" x="{i * 16}" width="16" height="12"/>' for i in range(drawing.LEVELS)
    )
    return Markup(
        f'<svg class="ramp" viewBox="0 0 {16 * drawing.LEVELS} 12" role="img" '
        f'aria-label="colours of the residual">{cells}</svg>'
    )


def _listed(x: float | list[float] | None) -> Markup:
    values = x if isinstance(x, list) else [x]
    return Markup("<br>").join(number_text.short(v) for v in values)
