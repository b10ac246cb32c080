"""Answer table: which effect, where, how large, how much of the gap, how sure; what is left; and
the equation of the corrected model. All of it is read off a report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from trueup.diagnose.number_text import percent, short, unit, with_interval
from trueup.diagnose.summary_text import (
    NEAREST,
    NEW_NUMBERS,
    SAME_NUMBERS,
    UNEXPLAINED,
    composition,
    estimated,
    is_above_floor,
    label_of,
    material_effects,
    name,
    shares,
)
from trueup.diagnose.tuning_of_answers import EVIDENCE

PLACES = {
    "force": "force at the {}",
    "command": "command, between issued and applied",
    "observation": "sensor, between state and log",
    "timing": "clock",
    "parameter": "parameters",
}
# errors over the horizon, as parts of the motion's standard deviation: what a controller that
# replans within the horizon hardly notices, and what makes its predictions worthless
SMALL, LARGE = 0.05, 0.3
MOST_PARAMETERS = 3  # refitted ones that a row names
MOST_CHANNELS = 2  # whose errors a sentence names
WORTH_A_LINE = 0.001  # of the gap: less is not listed
COUNTED = ("dropped_frames", "sensor_quantization")  # effects that are seen in the samples
PLAINLY = 1.1  # times the answer's error, where a report has no interval of the difference
SYMBOLS = (
    ("<=", "≤"),
    ("+-", "±"),
    ("^2", "²"),
    ("^3", "³"),
    ("2 pi", "2π"),
    ("4 pi", "4π"),
    (" - ", " − "),
    ("= -", "= −"),
    ("(-", "(−"),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the answer: `sizes` are parameters with their intervals; `is_slight` says that it
    stands back, `note` why."""

    what: str
    where: str
    sizes: tuple[tuple[str, str], ...]
    share: str
    sure: str
    is_slight: bool = False
    note: str = ""


def title(report: Mapping[str, Any]) -> str:
    """The answer in a few words."""
    match report["verdict"]:
        case "effect":
            material, _ = material_effects(report)
            text = " and ".join(map(name, material))
            if shares(report).get(NEW_NUMBERS, 0.0) > EVIDENCE.most_of_it:
                is_or_are = "is" if len(material) == 1 else "are"
                return f"The nominal parameters are off, and {text} {is_or_are} missing"
            return text[:1].upper() + text[1:]
        case "parameters_only":
            rest = "no effect is missing"
            if is_above_floor(report["gap"]):
                rest = "no known effect explains the rest"
            return f"The nominal parameters are off, and {rest}"
        case "no_gap":
            return "The nominal model already predicts as well as the noise allows"
        case _:
            return "A gap remains that no combination of known effects explains"


def rows(report: Mapping[str, Any]) -> list[Row]:
    """What closes the gap: effects, refitted parameters, integration and start, what closes most
    first; then what hardly matters, and what is left."""
    parts = shares(report)
    material, slight = material_effects(report)
    table = [
        (parts.get(name(e), 0.0), _effect_row(report, e, parts, is_slight=False)) for e in material
    ]
    if (share := parts.get(NEW_NUMBERS, 0.0)) >= EVIDENCE.worth_naming or _moved(report):
        table.append((share, _refitted_row(report, share)))
    start = parts.get(SAME_NUMBERS, 0.0)
    begins = Row(SAME_NUMBERS, "simulation", (), percent(start), "")
    if start >= EVIDENCE.worth_naming:
        table.append((start, begins))
    nearest = report.get("nearest")
    if nearest and nearest["effects"] and parts.get(NEAREST):
        what = f"nearest: {composition(nearest['effects'])}"
        table.append((parts[NEAREST], Row(what, "", (), percent(parts[NEAREST]), "not enough")))
    table.sort(key=lambda r: -r[0])
    last = [_effect_row(report, e, parts, is_slight=True) for e in slight]
    if WORTH_A_LINE <= start < EVIDENCE.worth_naming:
        last.append(replace(begins, is_slight=True))
    if (left := parts.get(UNEXPLAINED, 0.0)) >= WORTH_A_LINE:
        last.append(Row("not explained", "", (), percent(left), "", is_slight=True))
    return [] if report["verdict"] == "no_gap" else [row for _, row in table] + last


def _effect_row(
    report: Mapping[str, Any],
    entry: Mapping[str, Any],
    parts: Mapping[str, float],
    *,
    is_slight: bool,
) -> Row:
    place = PLACES.get(str(entry.get("port", "force")), "{}")
    joint = entry.get("joint", entry["channel"])
    where = place.format(joint)
    if "joint" in entry and "{}" not in place:
        where = f"{where}, at {joint}"
    share = parts.get(name(entry))
    return Row(
        name({"effect": entry["effect"]}),
        where,
        tuple(
            (label_of(parameter, number), _size(number)) for parameter, number in estimated(entry)
        ),
        percent(share) if share else "–",
        _sure(report, entry),
        is_slight,
        "hardly matters" if is_slight else "",
    )


def _size(number: Mapping[str, Any]) -> str:
    measure = unit(number.get("unit", ""))
    return f"{with_interval(number['value'], number['ci95'])} {measure}".rstrip()


def _moved(report: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """The parameters whose interval leaves the nominal value out, the furthest first."""
    moved = [
        (abs(p["value"] - p["nominal"]) / max(abs(p["nominal"]), 1e-12), parameter, p)
        for parameter, p in report["parameters"].items()
        if None not in p["ci95"] and not p["ci95"][0] <= p["nominal"] <= p["ci95"][1]
    ]
    return [(parameter, p) for _, parameter, p in sorted(moved, key=lambda m: -m[0])]


def _called(parameter: str, number: Mapping[str, Any]) -> str:
    """A parameter's symbol behind what it is called; an older report has the symbol alone."""
    label = number.get("label", parameter)
    return parameter if label == parameter else f"{label} {parameter}"


def _refitted_row(report: Mapping[str, Any], share: float) -> Row:
    moved = _moved(report)
    sizes = [
        (_called(parameter, p), f"{_size(p)}, was {short(p['nominal'])}")
        for parameter, p in moved[:MOST_PARAMETERS]
    ]
    if len(moved) > len(sizes):
        sizes.append((f"and {len(moved) - len(sizes)} more", ""))
    sure = "95 % intervals exclude nominal" if moved else "only jointly; none alone is certain"
    return Row("nominal parameters", "nominal model", tuple(sizes), percent(share), sure)


def _sure(report: Mapping[str, Any], entry: Mapping[str, Any]) -> str:
    """How certain it is that this effect acts, and no other in its place."""
    here = (entry["effect"], entry.get("joint"))
    others = [o for o in report["indistinguishable"] if here not in map(_key, o)]
    if others:
        return f"not told from {', or '.join(composition(o) for o in others)}"
    if entry["effect"] in COUNTED:
        return "counted in the samples"
    hypotheses = report["evidence"]["hypotheses"]
    least = next((h["validation"] for h in hypotheses if h.get("answer")), None)
    without = [
        h
        for h in hypotheses
        if h["validation"] is not None
        and h["parameters"] != "nominal"
        and here not in map(_key, h["effects"])
    ]
    if not least or not without:
        return "no explanation without it was compared"
    nearest = min(without, key=lambda h: float(h["validation"]))
    ratio = math.sqrt(nearest["validation"] / least)
    named = composition(nearest["effects"], "refitting alone")
    if ratio <= 1.0:
        more = len(nearest["effects"]) > len(report["effects"])
        with_more = ", with more effects" if more else ""
        return f"likely: {named} fits as well{with_more}"
    worse = (nearest.get("worse_ci95") or [None])[0]
    is_certain = worse > 0.0 if worse is not None else ratio >= PLAINLY
    sure = "certain" if is_certain else "likely"
    return f"{sure}: the next best explanation, {named}, errs {_times(ratio)}"


def _times(ratio: float) -> str:
    """How much larger an error is, in words."""
    return f"{percent(ratio - 1.0)} more" if ratio < 2.0 else f"{short(ratio)} times as much"  # noqa: PLR2004


def _key(effect: Any) -> tuple[str, str | None]:
    return (effect, None) if isinstance(effect, str) else (effect["effect"], effect.get("joint"))


def left_over(report: Mapping[str, Any]) -> str:
    """What the corrected model still misses over the horizon, in the channels' units, and whether
    that matters; empty where nothing but noise is left."""
    gap = report["gap"]
    channels: Mapping[str, Mapping[str, Any]] = gap.get("channels") or {}
    if not gap["floor"] or not is_above_floor(gap):
        return ""
    if not channels or not all("deviation" in c for c in channels.values()):
        return (
            f"What is left is {short(gap['after'] / gap['floor'])} times what noise alone makes, "
            "and no known effect explains it; the intervals are widened for it."
        )
    worst, most = max(channels.items(), key=lambda c: float(c[1]["after"]))
    named = channels if len(channels) <= MOST_CHANNELS else {worst: most}
    errors = " and ".join(
        f"{short(c['after'] * c['deviation'])} {unit(c['unit'])}".rstrip() + f" in {channel}"
        for channel, c in named.items()
    )
    part, at_worst = percent(most["after"]), "" if named is channels else "at worst "
    if most["after"] < SMALL:
        matters = f"{part} of its motion, which hardly matters"
    elif most["after"] < LARGE:
        matters = f"{part} of its motion: a controller that replans sooner meets smaller errors"
    else:
        matters = f"{part} of its motion: do not rely on predictions over this horizon"
    return (
        f"Over {gap['horizon_s']:g} s the corrected model still errs by {at_worst}{errors} (RMS); "
        f"in {worst} that is {matters}. No known effect explains what is left beyond noise; the "
        "intervals are widened for it."
    )


def equations(report: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """The equation of the corrected model, line by line: the nominal form, then each effect, with
    what it is called and its numbers; empty where the report has none."""
    lines = []
    if report.get("equation"):
        numbers = [f"{parameter} = {_size(p)}" for parameter, p in report["parameters"].items()]
        lines.append(("nominal form", symbols(report["equation"]), ", ".join(numbers)))
    for entry in report["effects"]:
        if entry.get("equation"):
            numbers = [
                f"{parameter.replace('_', ' ')} = {_size(number)}"
                for parameter, number in estimated(entry)
            ]
            lines.append((name(entry), symbols(entry["equation"]), ", ".join(numbers)))
    return lines


def symbols(equation: str) -> str:
    """An equation of a docstring with the signs of the field."""
    for plain, sign in SYMBOLS:
        equation = equation.replace(plain, sign)
    return equation
