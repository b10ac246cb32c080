"""The page of a randomisation: the family and what was drawn of it, where the deployment plant
lies, and what a wrong context costs."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from markupsafe import Markup

from trueup.diagnose.number_text import short
from trueup_pages.drawing import Scale
from trueup_pages.rendering import render

BODY = "randomisation_body.html"
SOURCES = {
    "identification": "identified from its adaptation episodes",
    "configuration": "as plant.json declares",
    "measurement": "measured",
}
MANY = 1000
WIDTH, HEIGHT, EDGE = 320.0, 34.0, 8.0


def sentence(document: Mapping[str, Any]) -> str:
    """Returns the answer in a sentence or two."""
    where = document["membership"]
    text = f"One map for {document['plants']} plants of a family. "
    samples = _inside(where["sample_box"], "among the samples")
    if where["family_box"] is None:
        text += f"The deployment plant lies {samples}; no family was declared."
    else:
        text += (
            f"The deployment plant lies {_inside(where['family_box'], 'the declared family')}, and "
            f"{samples}."
        )
    cost = [r for r in document["context_cost"][1:] if r["times"] is not None]
    if cost:
        worst = max(cost, key=lambda r: r["times"])
        text += (
            f" The context {worst['context']} instead of its own makes the conditioned model's "
            f"error {_times(worst['times'])} as large."
        )
    return text


def _times(times: float) -> str:
    return f"more than {MANY} times" if times > MANY else f"{short(times)} times"


def _inside(box: Mapping[str, Any], what: str) -> str:
    names = ", ".join(n for n, x in box["numbers"].items() if x["inside"] is False)
    if box["inside"] is False:
        return f"outside {what.removeprefix('among ')} ({names})"
    known = what if what.startswith("among") else f"inside {what}"
    return known if box["inside"] else f"perhaps {known}: not all of its parameters are known"


def view(document: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of the page's body."""
    errors = [
        r["rollout"] for r in (*document["errors"], *document["context_cost"]) if r["rollout"]
    ]
    return {
        "d": document,
        "answer": sentence(document),
        "source": SOURCES[document["context"]["by"]],
        "scale": Scale(errors),
        "ranges": {name: _range(document, name) for name in document["context"]["parameters"]},
    }


def report_page(document: Mapping[str, Any]) -> str:
    """Returns the study as one HTML file that loads nothing else."""
    title = f"Randomisation of {document['plant']}"
    return render("study_report.html", title=title, body=BODY, **view(document))


def _range(document: Mapping[str, Any], name: str) -> Markup:
    """Draws a number's family box, its samples, and where the deployment plant stands."""
    value = document["context"]["parameters"][name]
    drawn = document["drawn"].get(name, [])
    family = (document["family_box"] or {}).get(name)
    ends: list[float] = [value, *drawn, *(family or ())]
    low, high = min(ends), max(ends)
    span = (high - low) or abs(high) or 1.0

    def at(x: float) -> float:
        return float(EDGE + (x - low) / span * (WIDTH - 2.0 * EDGE))

    body = f'<line class="grid" x1="0" x2="{WIDTH:g}" y1="17" y2="17"/>'
    if family is not None:
        body += (
            f'<rect class="track" x="{at(family[0]):.1f}" y="8" '
            f'width="{max(at(family[1]) - at(family[0]), 1.0):.1f}" height="18" rx="3"/>'
        )
    body += "".join(f'<circle cx="{at(x):.1f}" cy="17" r="2.5"/>' for x in drawn)
    body += f'<line class="line nominal" x1="{at(value):.1f}" x2="{at(value):.1f}" y1="3" y2="31"/>'
    label = f"{name}: the family, its samples, and the deployment plant at {short(value)}"
    return Markup(
        f'<svg class="range" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="{escape(label)}">{body}</svg>'
    )
