"""The page of a designed excitation: what to check before it is played, the command and the motion
under every model in play, and what it tells beside random commands within the same bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from trueup.diagnose.number_text import percent, short, unit
from trueup_pages.curves import Axis, Curve, colour, curves, key
from trueup_pages.rendering import render

BODY = "excitation_body.html"
TIME = "time [s]"
FAR = 4.0  # times the range of the motion: bounds further apart are not drawn


def sentence(document: Mapping[str, Any]) -> str:
    """The answer in a sentence or two."""
    length, members = short(document["duration_s"]), document["members"]
    if document["breaches"]:
        kept = (
            f"leaves its bounds under {document['breaches']} of {members} models: do not play it "
            "as it is"
        )
    else:
        ends = "ends at rest" if document["rests"] else "does not end at rest"
        kept = f"keeps its bounds under all {members} models, and {ends}"
    return f"A command of {length} s that {kept}. {_worth(document)}"


def _worth(document: Mapping[str, Any]) -> str:
    figures = document["figures"]
    if document["goal"] == "split":
        least = min(figures, key=lambda f: f["designed"])
        return (
            f"The alternative that it separates least, {least['what']}, lies "
            f"{short(least['designed'])} standard errors from the answer; random commands separate "
            f"it by {short(least['random'])}."
        )
    widths = [
        f["designed"] / f["random"]
        for f in figures
        if f["what"] in document["information"]["half_widths"] and f["designed"] and f["random"]
    ]
    if not widths:
        return "It does not determine any number."
    low, high = short(min(widths)), short(max(widths))
    times = f"{low} times" if low == high else f"{low} to {high} times"
    return (
        f"It leaves intervals that are {times} as wide as those that random commands within the "
        "same bounds leave."
    )


def view(document: Mapping[str, Any]) -> dict[str, Any]:
    """The values of the page's body."""
    return {
        "d": document,
        "answer": sentence(document),
        "pictures": [
            *(_command(document["drawn"]["t_s"], c) for c in document["drawn"]["commands"]),
            *(_motion(document["drawn"]["t_s"], o) for o in document["drawn"]["observations"]),
        ],
        "used": percent(document["envelope_used"]),
        "kept_free": percent(document["margin"]),
    }


def report_page(document: Mapping[str, Any]) -> str:
    """The report as one file that needs no other."""
    title = f"An excitation for {document['plant']}"
    return render("study_report.html", title=title, body=BODY, **view(document))


def _command(t_s: list[float], channel: Mapping[str, Any]) -> Markup:
    lines = [
        Curve("command", colour(0), tuple(zip(t_s, channel["values"], strict=True))),
        *_levels("limit", t_s, channel["limits"]),
    ]
    return _drawn(lines, channel, "the command")


def _motion(t_s: list[float], channel: Mapping[str, Any]) -> Markup:
    """The motion; bounds that lie so far away that it would look flat beside them are left out, and
    named."""
    low, high = min(channel["low"]), max(channel["high"])
    bounds = channel["bounds"]
    far = bounds is not None and bounds[1] - bounds[0] > FAR * (high - low)
    lines = [
        *(
            Curve(
                "lowest and highest of all models",
                "bar",
                tuple(zip(t_s, channel[end], strict=True)),
            )
            for end in ("low", "high")
        ),
        *(
            Curve(name, colour(i), tuple(zip(t_s, values, strict=True)))
            for i, (name, values) in enumerate(channel["central"].items())
        ),
        *_levels("bound", t_s, None if far else bounds),
    ]
    away = (
        f"Bounds at {short(bounds[0])} and {short(bounds[1])}, beyond the picture." if far else ""
    )
    return _drawn(lines, channel, "the motion under every model") + Markup(
        '<p class="pale">{}</p>'
    ).format(away)


def _levels(name: str, t_s: list[float], levels: list[float] | None) -> list[Curve]:
    ends = (t_s[0], t_s[-1])
    return [
        Curve(name, "bad", tuple((t, level) for t in ends), dashed=True) for level in levels or ()
    ]


def _drawn(lines: list[Curve], channel: Mapping[str, Any], what: str) -> Markup:
    along = Axis(f"{channel['name']} [{unit(channel['unit'])}]")
    return curves(lines, Axis(TIME), along, f"{what} over time: {channel['name']}") + key(lines)
