"""Page: a blind trial to look at: who was taken for whom, how far a verdict may be trusted, and how it was kept blind."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from trueup.diagnose.page import section, whole

CELL, LEFT, TOP = 22, 210, 190
MATRIX = """
.matrix text{font-size:12px}.matrix .count{fill:var(--ink);text-anchor:middle}tr.miss td{color:var(--before)}
"""
KINDS = {
    "single": "one effect",
    "pair": "two effects",
    "outside": "something beyond the catalogue",
    "none": "no effect",
    "faint": "an effect about as large as the noise",
}


def sentence(document: Mapping[str, Any]) -> str:
    """The result in a sentence or two."""
    if document["leak"]["void"]:
        return (
            f"Void: {document['leak']['taken']} of {document['leak']['baits']} baits were taken, so the diagnosis has seen what was hidden."
        )
    single = document["kinds"].get("single")
    text = f"{document['trials']} machines after {document['plant']}, their effects withheld"
    if single:
        text += f": single effects named exactly in {_part(single['exact'])}, the truth among the answers in {_part(single['in_set'])}"
    return text + "."


def _part(rate: Mapping[str, Any]) -> str:
    return "–" if rate["share"] is None else f"{rate['share']:.0%} (at least {rate['at_least']:.0%})"


def page(document: Mapping[str, Any]) -> str:
    """The report as one HTML page that needs nothing else."""
    d = document
    parts = [
        f"<header><p class=pale>Blind trial of {escape(d['plant'])}</p><h1>{escape(sentence(d))}</h1></header>",
        section("Taken for", _matrix(d)),
        section("How often right", _kinds(d)),
        section("How far an answer may be trusted here", _trust(d)),
        section("What the intervals cover, what the correction closes", _coverage(d)),
        section("Every trial", _rows(d)),
        section("How it was kept blind", _blind(d)),
    ]
    return whole(f"Blind trial of {d['plant']}", parts, MATRIX)


def _matrix(d: Mapping[str, Any]) -> str:
    """Hidden effects down, answers across; pairs are left to the list, as each is nearly its own row."""
    cells = [c for c in d["confusion"] if " + " not in c["truth"]]
    truths = sorted({c["truth"] for c in cells})
    answers = truths + sorted({c["answer"] for c in cells} - set(truths))
    most = max((c["n"] for c in cells), default=1)
    drawn = []
    for i, truth in enumerate(truths):
        y = TOP + CELL * i
        drawn.append(f"<text x={LEFT - 8} y={y + 15} text-anchor=end>{_plain(truth)}</text>")
        drawn.append(f"<line x1={LEFT} x2={LEFT + CELL * len(answers)} y1={y} y2={y} stroke='var(--line)'/>")
    for j, answer in enumerate(answers):
        x = LEFT + CELL * j
        drawn.append(f"<text transform='translate({x + 15},{TOP - 8}) rotate(-60)'>{_plain(answer)}</text>")
    for c in cells:
        x, y = LEFT + CELL * answers.index(c["answer"]), TOP + CELL * truths.index(c["truth"])
        colour = "var(--good)" if c["truth"] == c["answer"] else "var(--before)"
        drawn.append(
            f"<rect x={x + 1} y={y + 1} width={CELL - 2} height={CELL - 2} rx=3 fill='{colour}' fill-opacity={0.25 + 0.6 * c['n'] / most:.2f} />"
            f"<text class=count x={x + CELL / 2} y={y + 15}>{c['n']}</text>"
        )
    width, height = LEFT + CELL * len(answers) + 120, TOP + CELL * len(truths) + 8
    return (
        "<p class=pale>Hidden down, answered across. Green: as hidden. An answer that no measurement on this plant tells from the hidden effect "
        "stands in its own column, and is right if the report lists the other beside it.</p>"
        f"<svg class=matrix viewBox='0 0 {width} {height}' style='width:{width}px' role=img aria-label='confusion matrix'>{''.join(drawn)}</svg>"
    )


def _plain(name: str) -> str:
    return escape(name.replace("_", " "))


def _kinds(d: Mapping[str, Any]) -> str:
    rows = [
        f"<tr><td>{KINDS[kind]}<td class=n>{k['n']}<td class=n>{_part(k['exact'])}<td class=n>{_part(k['in_set'])}<td class=n>{k['alternatives']:.2f}</tr>"
        for kind, k in d["kinds"].items()
    ]
    head = (
        "<tr><th>hidden<th class=n>machines<th class=n>exactly named<th class=n>among the answers<th class=n>mean further alternatives</tr>"
    )
    refused = f" {d['refused']} diagnoses were refused or failed, and count as wrong." if d["refused"] else ""
    return f"<table>{head}{''.join(rows)}</table><p class=pale>“At least”: with 95 % confidence.{refused}</p>"


def _trust(d: Mapping[str, Any]) -> str:
    rows = [
        f"<tr><td>{_plain(t['answer'])}<td class=n>{t['right']} of {t['n']}<td class=n>{t['at_least']:.0%}</tr>"
        for t in sorted(d["trust"], key=lambda t: (-t["n"], t["answer"]))
    ]
    return (
        "<table><tr><th>when the answer is<th class=n>it was right<th class=n>at least, with 95 % confidence</tr>"
        + "".join(rows)
        + "</table>"
    )


def _coverage(d: Mapping[str, Any]) -> str:
    c = d["coverage"]
    names = {
        "effects": "95 % intervals of effects' numbers",
        "parameters": "95 % intervals of the family's parameters",
        "bounds": "bounds on hidden effects that were not named",
    }
    rows = [
        f"<tr><td>{words}<td class=n>{'–' if c[key]['share'] is None else format(c[key]['share'], '.0%')}<td class=n>{c[key]['n']}</tr>"
        for key, words in names.items()
    ]
    closed = d["closed"]
    text = ""
    if closed:
        text = f"<p>Of the gap on recordings kept for measuring ({closed['n']} machines with one or two effects; commands of the validation episodes, backwards), the median correction closes {closed['median']:.1%}, the worst tenth {closed['worst_tenth']:.1%}"
        text += (
            f"; the reports were off by {closed['reported_off_p90']:.3f} or less in nine of ten.</p>"
            if closed["reported_off_p90"]
            else ".</p>"
        )
    return f"<table><tr><th>what<th class=n>hold the truth<th class=n>of</tr>{''.join(rows)}</table>{text}"


def _rows(d: Mapping[str, Any]) -> str:
    rows = []
    for r in d["rows"]:
        hidden = " + ".join(r["label"]["effects"]) or f"no effect (bait: {r['label']['bait']})"
        closed = "–" if r["closed"] is None else f"{r['closed']:.1%}"
        others = ", ".join(
            " + ".join(e if isinstance(e, str) else f"{e['effect']} at {e['joint']}" for e in o) for o in r["indistinguishable"]
        )
        mark = "" if r["exact"] else " class=miss"
        rows.append(
            f"<tr{mark}><td class=n>{r['index']}<td>{_plain(hidden)}<td class=n>{r['label']['gap']:.3f}<td>{_plain(r['answer'])}<td>{_plain(others)}"
            f"<td class=n>{closed}<td class=n>{r['seconds']:.1f}<td><code>{r['commitment'][:10]}</code></tr>"
        )
    head = "<tr><th class=n>#<th>hidden<th class=n>its size<th>answered<th>not told from<th class=n>closed<th class=n>s<th>commitment</tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _blind(d: Mapping[str, Any]) -> str:
    b, leak = d["bench"], d["leak"]
    feedback = (
        "under the recorded commands alone"
        if b["feedback"] is None
        else "under the recorded commands and a weak feedback to the recorded motion"
    )
    out = f" Left out, as the nominal form takes them up on these channels: {', '.join(b['left_out'])}." if b["left_out"] else ""
    links = "the robot's links by MuJoCo, " if b["robot"] else ""
    again = " The secret was given, not drawn: this repeats a trial that was opened before." if d["opening"]["redrawn"] else ""
    return (
        f"<p>Machines were simulated at {b['fine_step_s'] * 1e3:.3g} ms by a program that shares no line with the one that fits, "
        f"{links}with other laws of friction, "
        f"hysteresis and stops, {feedback}, and logged every {b['period_s'] * 1e3:.3g} ms with the noise of the user's log.{_plain(out)}</p>"
        "<p>Each label was committed by its salted SHA-256 before the first diagnosis. The diagnoses ran in processes that were told a folder of recordings and "
        f"nothing else. {leak['baits']} machines without an effect carried the label of one as a bait: {leak['taken']} taken.{again}</p>"
        f"<p class=pale>Opened: secret <code>{d['opening']['secret']}</code>. trueup {escape(d['version'])}</p>"
    )
