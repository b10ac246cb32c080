"""The page of a consistency study, and the part of a diagnosis that says whether its recordings
agree: each number by the recordings, days and conditions that say something of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from trueup.diagnose.number_text import plus_minus, short, unit
from trueup.diagnose.summary_text import (
    MOST_NUMBERS,
    composition,
    number_name,
    recording_name,
    some_of,
)
from trueup_pages import drawing
from trueup_pages.rendering import render

BODY = "consistency_body.html"
WIDE = 8.0  # times the narrowest interval: a wider one does not stretch the axis
RARE = 0.001  # a smaller probability has no digits of its own
Names = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Line:
    """What one subset says of a number: its name, the interval drawn, and in words; `is_apart` says
    that it is one of the two furthest from each other."""

    subset: str
    drawn: Markup
    words: str
    is_apart: bool = False


@dataclass(frozen=True, slots=True)
class Part:
    """The subsets of one grouping: whether they agree, in words, and a line each."""

    grouping: str
    verdict: str
    contradicts: bool
    lines: Sequence[Line]


@dataclass(frozen=True, slots=True)
class Estimated:
    """One number: what it is called, all recordings together, and the subsets."""

    called: str
    together: Line
    parts: Sequence[Part]
    contradicts: bool


def names_of(document: Mapping[str, Any]) -> dict[str, str]:
    """What a study's recordings are called, by digest."""
    named = {r["sha256"]: r["name"] for r in document["recordings"] if r.get("name")}
    return {r["sha256"]: recording_name(r["sha256"], named) for r in document["recordings"]}


def sentence(document: Mapping[str, Any]) -> str:
    """The answer in a sentence or two."""
    recordings, numbers = len(document["recordings"]), document["numbers"]
    compared = [n for n in numbers if n["by"]]
    if not compared:
        return f"None of the {recordings} recordings determines a number of the model by itself."
    apart = [n for n in compared if _worst(n)["contradicts"]]
    if not apart:
        text = (
            f"The {recordings} recordings agree on "
            f"{_counted(len(compared))}, as far as their intervals can tell."
        )
    else:
        called = some_of([number_name(n) for n in apart], MOST_NUMBERS)
        text = (
            f"The {recordings} recordings do not agree on {len(apart)} of "
            f"{_counted(len(compared))}: {called}. "
            f"{_furthest(apart, names_of(document))}"
        )
    return f"{text} {_of_diagnoses(document)}".rstrip()


def _counted(numbers: int) -> str:
    return f"{numbers} number{'s' if numbers > 1 else ''}"


def _worst(number: Mapping[str, Any]) -> Mapping[str, Any]:
    """The grouping by which a number differs most plainly."""
    worst: Mapping[str, Any] = min(number["by"], key=lambda b: b["p"])
    return worst


def _furthest(numbers: Sequence[Mapping[str, Any]], names: Names) -> str:
    """The number that differs most plainly, by the two subsets that lie furthest apart."""
    number = min(numbers, key=lambda n: _worst(n)["p"])
    worst = _worst(number)
    if worst["apart"] is None:
        return ""
    says = {s["subset"]: s for s in worst["subsets"]}
    first, second = (
        f"{names.get(which, which)} says {_size(says[which], number)}" for which in worst["apart"]
    )
    return f"Furthest apart, {first} and {second} for {number_name(number)}."


def _of_diagnoses(document: Mapping[str, Any]) -> str:
    """Whether diagnoses of the subsets name the same effects."""
    rows = [r for r in document["diagnoses"] if "verdict" in r]
    if len(rows) < 2:  # noqa: PLR2004 - one has nothing to differ from
        return ""
    answers = {
        (r["verdict"], tuple(sorted((e["effect"], e.get("joint") or "") for e in r["effects"])))
        for r in rows
    }
    same = "the same answer" if len(answers) == 1 else f"{len(answers)} different answers"
    return f"Diagnosed alone, {len(rows)} subsets give {same}."


def _size(estimate: Mapping[str, Any], number: Mapping[str, Any]) -> str:
    low, high = estimate["ci95"]
    size = plus_minus(estimate["value"], (high - low) / 2.0)
    return f"{size} {unit(number['unit'])}".rstrip()


def view(document: Mapping[str, Any]) -> dict[str, Any]:
    """The values of the page's body."""
    names = names_of(document)
    heading, dot, details = sentence(document).partition(". ")
    return {
        "d": document,
        "answer": heading + dot.strip(),
        "details": details,
        "names": names,
        "estimated": estimated(document["numbers"], names),
        "composition": composition(document["effects"], "the nominal form without effects"),
        "diagnoses": [_diagnosed(r) for r in document["diagnoses"]],
        "earlier": [_diagnosed(r) for r in document.get("earlier", ())],
    }


def _diagnosed(row: Mapping[str, Any]) -> dict[str, str]:
    """A diagnosis as a row: of what, the effects that it names, and what it says."""
    named = [{k: e[k] for k in ("effect", "joint") if k in e} for e in row.get("effects", ())]
    return {
        "of": f"{row['grouping']} {row['subset']}",
        "effects": composition(named, "no effect") if "verdict" in row else "",
        "says": row.get("sentence") or row["problem"],
    }


def estimated(numbers: Sequence[Mapping[str, Any]], names: Names) -> list[Estimated]:
    """Numbers with what their subsets say, those that differ first."""
    shown = [_estimated(n, names) for n in numbers if n["by"]]
    return sorted(shown, key=lambda e: not e.contradicts)


def of_diagnosis(report: Mapping[str, Any], names: Names) -> list[Estimated]:
    """What the recordings of a diagnosis say of its numbers, one by one; empty where none could be
    compared, or the report is an older one."""
    numbers = []
    for entry in report.get("between_recordings", ()):
        subsets = [{**r, "subset": r["sha256"]} for r in entry["recordings"]]
        by = {**entry, "grouping": "recording", "subsets": subsets}
        numbers.append({**entry, "ci95": entry["together"], "by": [by]})
    digests = {r["sha256"] for n in numbers for r in n["recordings"]}
    return estimated(numbers, {d: recording_name(d, names) for d in digests})


def _estimated(number: Mapping[str, Any], names: Names) -> Estimated:
    every = [number, *(s for b in number["by"] for s in b["subsets"])]
    scale = _axis(every)

    def line(subset: str, estimate: Mapping[str, Any], kind: str, *, apart: bool = False) -> Line:
        drawn = drawing.interval(scale, estimate["value"], estimate["ci95"], kind)
        return Line(subset, drawn, _size(estimate, number), apart)

    parts = [
        Part(
            b["grouping"],
            _verdict(b, number),
            bool(b["contradicts"]),
            [
                line(
                    names.get(s["subset"], s["subset"]),
                    s,
                    "bad" if s["subset"] in (b["apart"] or ()) and b["contradicts"] else "other",
                    apart=s["subset"] in (b["apart"] or ()),
                )
                for s in sorted(b["subsets"], key=lambda s: names.get(s["subset"], s["subset"]))
            ],
        )
        for b in number["by"]
    ]
    called = number_name(number)
    return Estimated(
        called[0].upper() + called[1:] if number["effect"] else called,
        line("all together", number, "answer"),
        parts,
        any(p.contradicts for p in parts),
    )


def _axis(estimates: Sequence[Mapping[str, Any]]) -> drawing.Linear:
    """An axis that shows every value that is known at all well, with its interval."""
    narrowest = min(e["ci95"][1] - e["ci95"][0] for e in estimates)
    known = [e["ci95"] for e in estimates if e["ci95"][1] - e["ci95"][0] <= WIDE * narrowest]
    low, high = min(c[0] for c in known), max(c[1] for c in known)
    margin = 0.05 * (high - low)
    return drawing.Linear(low - margin, high + margin)


def _verdict(by: Mapping[str, Any], number: Mapping[str, Any]) -> str:
    """Whether the subsets of a grouping agree, in words."""
    chance = f"by chance: {100.0 * by['p']:.1f} %" if by["p"] >= RARE else "by chance: < 0.1 %"
    if by["contradicts"]:
        deviation = f"{short(by['deviation'])} {unit(number['unit'])}".rstrip()
        return (
            f"differ: standard deviation {deviation} between them, beyond their own uncertainty "
            f"({chance})"
        )
    if by.get("widens"):
        return f"may differ ({chance}); the interval of the answer is wider for it"
    if by["apart"]:
        return f"differ, but no more than chance allows ({chance})"
    return "agree within their intervals"


def report_page(document: Mapping[str, Any]) -> str:
    """The study as one HTML file that loads nothing else."""
    title = f"Consistency of {document['plant']}"
    return render("study_report.html", title=title, body=BODY, **view(document))
