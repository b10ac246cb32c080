"""The page of a blind trial: the confusion matrix, how often verdicts are right, and the proof that
it was blind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup, escape

from trueup_pages.rendering import render

CELL, LEFT, TOP = 22, 210, 190
KINDS = {
    "single": "one effect",
    "pair": "two effects",
    "outside": "something beyond the catalogue",
    "none": "no effect",
    "faint": "an effect about as large as the noise",
}
COVERED = {
    "effects": "95 % intervals of effects' numbers",
    "parameters": "95 % intervals of the family's parameters",
    "bounds": "bounds on hidden effects that were not named",
}


def sentence(document: Mapping[str, Any]) -> str:
    """Returns the result in a sentence or two."""
    if document["leak"]["void"]:
        return (
            f"Void: {document['leak']['taken']} of {document['leak']['baits']} decoys were "
            "taken, so the diagnosis has seen what was hidden."
        )
    single = document["kinds"].get("single")
    text = f"{document['trials']} simulated machines like {document['plant']}, effects hidden"
    if single:
        text += (
            f": single effects named exactly in {_share_text(single['exact'])}, the truth among "
            f"the answers in {_share_text(single['in_set'])}"
        )
    return f"{text}. {_misses(document)}"


def _misses(document: Mapping[str, Any]) -> str:
    """Every machine that was not answered exactly, by what was hidden in it."""
    missed: dict[str, list[int]] = {}
    for row in document["rows"]:
        if not row["exact"]:
            missed.setdefault(row["label"]["kind"], []).append(row["index"])
    if not missed:
        return "None was missed."
    parts = [
        f"{len(indices)} of {document['kinds'][kind]['n']} with {KINDS[kind]} "
        f"({', '.join(f'#{i}' for i in indices)})"
        for kind, indices in missed.items()
    ]
    return f"Not named exactly: {'; '.join(parts)}."


def _share_text(rate: Mapping[str, Any]) -> str:
    return (
        "–" if rate["share"] is None else f"{rate['share']:.0%} (at least {rate['at_least']:.0%})"
    )


def page(document: Mapping[str, Any]) -> str:
    """Returns the report as one HTML page that loads nothing else."""
    return render("blindtrial.html", **view(document))


def view(document: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of the page's body."""
    trust = sorted(document["trust"], key=lambda t: (-t["n"], t["answer"]))
    return {
        "d": document,
        "answer": sentence(document),
        "matrix": _matrix(document),
        "trust": trust,
        "kinds": KINDS,
        "covered": COVERED,
    }


def _matrix(d: Mapping[str, Any]) -> Markup:
    """Draws the confusion matrix: hidden effects down, answers across.

    Pairs of effects are left to the list, because nearly each would be its own row.
    """
    cells = [c for c in d["confusion"] if " + " not in c["truth"]]
    truths = sorted({c["truth"] for c in cells})
    answers = truths + sorted({c["answer"] for c in cells} - set(truths))
    most = max((c["n"] for c in cells), default=1)
    drawn = []
    for i, truth in enumerate(truths):
        y = TOP + CELL * i
        drawn.append(f'<text x="{LEFT - 8}" y="{y + 15}" text-anchor="end">{_plain(truth)}</text>')
        drawn.append(
            f'<line class="grid" x1="{LEFT}" x2="{LEFT + CELL * len(answers)}" y1="{y}" y2="{y}"/>'
        )
    for j, answer in enumerate(answers):
        x = LEFT + CELL * j
        drawn.append(
            f'<text transform="translate({x + 15},{TOP - 8}) rotate(-60)">{_plain(answer)}</text>'
        )
    for c in cells:
        x, y = LEFT + CELL * answers.index(c["answer"]), TOP + CELL * truths.index(c["truth"])
        kind, strong = (
            "floor" if c["truth"] == c["answer"] else "nominal",
            0.25 + 0.6 * c["n"] / most,
        )
        drawn.append(
            f'<rect class="{kind}" x="{x + 1}" y="{y + 1}" width="{CELL - 2}" '
            f'height="{CELL - 2}" rx="3" fill-opacity="{strong:.2f}"/>'
            f'<text class="count" x="{x + CELL / 2}" y="{y + 15}">{c["n"]}</text>'
        )
    width, height = LEFT + CELL * len(answers) + 120, TOP + CELL * len(truths) + 8
    box = f'class="matrix" width="{width}" viewBox="0 0 {width} {height}"'
    return Markup(f'<svg {box} role="img" aria-label="confusion matrix">{"".join(drawn)}</svg>')


def _plain(name: str) -> str:
    return str(escape(name.replace("_", " ")))
