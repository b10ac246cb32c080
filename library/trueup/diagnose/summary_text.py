"""Summary text: a report's answer in a sentence, and the names that people read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import Any

from trueup.diagnose.number_text import percent, plus_minus, short, unit, with_interval
from trueup.diagnose.tuning_of_answers import EVIDENCE

HYPHENATED = {"load_dependent_friction": "load-dependent friction"}
PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}
MOST_NUMBERS = 3  # that a sentence names
SHORT_DIGEST = 12  # digits of a recording's digest
MOST_RECORDINGS = 3  # that a sentence names
UNNAMED: Mapping[str, str] = MappingProxyType({})  # what no recording is called
SAME_NUMBERS, NEW_NUMBERS = "integration and start", "refitted parameters"
NEAREST = "nearest combination"
UNEXPLAINED, NOISE = "not explained", "noise floor"
EFFECTS = "effects"
# faults of a log with which no diagnosis of the machine means anything
MISLEADING = (
    "position_unit",
    "velocity_unit",
    "length_unit",
    "command_sign",
    "command_scale",
    "joints_swapped",
    "topic_offset",
    "velocity_sign",
)
NO_GAP = "The nominal model already predicts as well as the noise allows"
UNKNOWN = "A gap remains that no combination of known effects explains"
REFITTING = "Refitting the nominal parameters"


def sentence(document: Mapping[str, Any]) -> str:
    """The answer of a report in a sentence or two; what the log's own faults put in doubt first."""
    gap = document["gap"]
    doubts = _doubts(document)
    match document["verdict"]:
        case "effect":
            text = _effects(document) + _incomplete(document)
        case "parameters_only":
            text = _new_numbers(document)
        case "no_gap":
            text = NO_GAP if gap["closed"] is None else _same_numbers(document)
        case _:
            text = UNKNOWN + _nearest_words(document)
    if gap["closed"] is not None:
        text += (
            f". The held-out error falls from {short(gap['before'])} to {short(gap['after'])}; "
            f"noise alone makes {short(gap['floor'])}"
        )
    others = document["indistinguishable"]
    if others:
        text += ". The recordings cannot tell this from " + ", or ".join(
            composition(o) for o in others
        )
    return doubts + text + _put_aside(document) + "."


def _put_aside(document: Mapping[str, Any]) -> str:
    """Where something else acted, which the answer leaves out; an older report does not say."""
    places = [
        f"{short(s['from_s'])} to {short(s['to_s'])} s of {s['episode'][:SHORT_DIGEST]}"
        for s in document.get("evidence", {}).get("put_aside", [])
    ]
    if not places:
        return ""
    what = "Left out, since no effect explains what happened there (a push from outside?)"
    return f". {what}: {', '.join(places)}"


def _doubts(document: Mapping[str, Any]) -> str:
    """What has to be mended in the log before the answer means anything; empty where nothing has.
    An older report has no findings."""
    faults = [
        _fault_words(f)
        for f in document.get("findings", [])
        if f["finding"] in MISLEADING and not f["applied"]
    ]
    return (
        f"Mend the log first: {', '.join(dict.fromkeys(faults))}. As recorded: " if faults else ""
    )


def _fault_words(finding: Mapping[str, Any]) -> str:
    """A fault in words, with its channel: command sign of u."""
    fault = finding["finding"].replace("_", " ")
    words = f"{fault} samples" if fault == "stuck" else fault
    return f"{words} of {finding['channel']}" if finding["channel"] else words


def faults(document: Mapping[str, Any], names: Mapping[str, str] = UNNAMED) -> list[str]:
    """What is wrong with the log, a sentence or two for each fault of a channel: in which
    recordings, what shows it, and the mend, where it was not applied. `names` are those of
    recordings by digest. An older report has no findings."""
    alike: dict[tuple[str, str | None], list[Mapping[str, Any]]] = {}
    for f in document.get("findings", []):
        alike.setdefault((f["finding"], f["channel"]), []).append(f)
    sentences = []
    for findings in alike.values():
        f = findings[0]
        head = _fault_words(f) + _in_recordings(document, findings, names)
        more = f"; {len(findings) - 1} more like it" if len(findings) > 1 else ""
        done = f"Done: {f['mend'][0].lower()}{f['mend'][1:]}" if f["applied"] else f["mend"]
        sentences.append(f"{head[0].upper()}{head[1:]}: {f['evidence']}{more}. {done}")
    return sentences


def _in_recordings(
    document: Mapping[str, Any], findings: Sequence[Mapping[str, Any]], names: Mapping[str, str]
) -> str:
    """The recordings that have a fault, where not all of them do."""
    digests = list(dict.fromkeys(d for f in findings for d in f.get("episodes", ())))
    if not digests or len(digests) >= len(document["evidence"]["episodes"]):
        return ""
    named = [recording_name(d, names) for d in digests]
    return f" in {some_of(named, MOST_RECORDINGS)}"


def recording_name(digest: str, names: Mapping[str, str]) -> str:
    """What a recording is called: by its name, else by the first digits of its digest."""
    return names.get(digest, digest[:SHORT_DIGEST])


def _same_numbers(document: Mapping[str, Any]) -> str:
    """What helps a nominal model whose parameters hold."""
    shares, text = _shares(document), "No effect is missing and no parameter has to change"
    # an older report does not separate integration and start from refitted parameters
    if _is_worth_naming(shares, SAME_NUMBERS):
        text += (
            f". The integration scheme and the filtered start of this diagnosis close "
            f"{percent(shares[SAME_NUMBERS])} of the gap"
        )
        if _is_worth_naming(shares, NEW_NUMBERS):
            text += (
                f"; refitting closes another {percent(shares[NEW_NUMBERS])}, which is not certain "
                "to be an improvement"
            )
    return text


def _new_numbers(document: Mapping[str, Any]) -> str:
    """How much of the gap refitting closes, alone or beside integration and start."""
    shares, left = _shares(document), is_above_floor(document["gap"])
    beside = _is_worth_naming(shares, SAME_NUMBERS)
    share = shares.get(NEW_NUMBERS, 1.0)
    if beside or (left and share <= EVIDENCE.most_of_it):
        part = f"{percent(share)} of the gap"
    else:
        part = "most of the gap" if left else "the gap"
    text = f"{REFITTING} closes {part}{_and_others(shares, SAME_NUMBERS)}"
    text += _carried(document) or _moved(document)
    if left:
        return f"{text}. No known effect closes a material part of the rest"
    return f"{text}. No effect is missing"


def _incomplete(document: Mapping[str, Any]) -> str:
    """That a part certainly acts, and what it leaves; an older report does not say."""
    left = document.get("incomplete")
    if left is None:
        return ""
    return (
        f". The effect is certain, but its equation is incomplete: over all recordings "
        f"{percent(left)} of the squared error after refitting remains"
    )


def _carried(document: Mapping[str, Any]) -> str:
    """The mass that the refitted parameters are, and the links on which it would look the same;
    empty where they are none. An older report does not say."""
    payload = document.get("payload")
    if not payload:
        return ""
    low, high = payload["mass"]["ci95"]
    mass = plus_minus(payload["mass"]["value"], (high - low) / 2.0)
    across = payload["centre"]["value"][:2]
    away = ""
    if None not in across:
        away = f", {short(math.hypot(*across))} m from the axis of its joint"
    first, *others = payload["links"]
    text = f". The change is that of {mass} kg more on the link of {first}{away}"
    return f"{text} (the link of {' or '.join(others)} is equally possible)" if others else text


def _moved(document: Mapping[str, Any]) -> str:
    """The numbers that certainly moved, those that moved most by their own size first; empty where
    none did."""
    certain = [
        (abs(p["value"] - p["nominal"]) / max(abs(p["nominal"]), 1e-12), name, p)
        for name, p in document.get("parameters", {}).items()
        if p["nominal"] and not p["ci95"][0] <= p["nominal"] <= p["ci95"][1]
    ]
    words = [
        f"{name} {short(p['nominal'])} to "
        f"{plus_minus(p['value'], (p['ci95'][1] - p['ci95'][0]) / 2.0)} "
        f"{unit(p.get('unit', ''))}".rstrip()
        for _, name, p in sorted(certain, key=lambda c: -c[0])[:MOST_NUMBERS]
    ]
    return f": {', '.join(words)}" if words else ""


def _nearest_words(document: Mapping[str, Any]) -> str:
    """What comes nearest to an unknown effect, and what it leaves; an older report does not say."""
    nearest = document.get("nearest")
    if not nearest or not nearest["effects"] or nearest["leaves"] is None:
        return ""
    return (
        f". The nearest is {composition(nearest['effects'])}, with which "
        f"{percent(min(nearest['leaves'], 1.0))} of the error after refitting remains"
    )


def _effects(document: Mapping[str, Any]) -> str:
    """What acts, and how much of the gap it closes; refitting first where it closes most."""
    every, parts = shares(document), _shares(document)
    material, slight = material_effects(document)
    joined = " and ".join(_with_estimate(e) for e in material)
    closes = "closes" if len(material) == 1 else "close"
    closed = sum(every.get(name(e), 0.0) for e in material)
    part = percent(closed) if closed else None
    if parts.get(NEW_NUMBERS, 0.0) > EVIDENCE.most_of_it:
        text = (
            f"{REFITTING} closes {percent(parts[NEW_NUMBERS])} of the gap"
            f"{_and_others(parts, SAME_NUMBERS)}. "
        )
        named = joined[:1].upper() + joined[1:]
        text += (
            f"{named} {closes} {part}" if part else f"{named.rstrip(',')} {_acts(material)}, too"
        )
    elif part:
        text = f"{joined} {closes} {part} of the gap{_and_others(parts, NEW_NUMBERS, SAME_NUMBERS)}"
    else:
        text = f"{joined.rstrip(',')} {_acts(material)}"
    if slight:
        names = " and ".join(map(name, slight))
        close = "closes" if len(slight) == 1 else "close"
        text += (
            f". {names[0].upper()}{names[1:]} {_acts(slight)}, too, but {close} less than "
            f"{100.0 * EVIDENCE.worth_naming:g} % of the gap"
        )
    return text[:1].upper() + text[1:]


def _acts(entries: Sequence[Any]) -> str:
    return "acts" if len(entries) == 1 else "act"


def material_effects(
    document: Mapping[str, Any],
) -> tuple[list[Mapping[str, Any]], list[Mapping[str, Any]]]:
    """The effects that are worth a headline, what closes most first, and those that matter less; if
    none is, all are."""
    parts = shares(document)
    entries = sorted(document["effects"], key=lambda e: -parts.get(name(e), 0.0))
    material = [e for e in entries if parts.get(name(e), 0.0) >= EVIDENCE.worth_naming]
    if not material:
        return entries, []
    return material, [e for e in entries if e not in material]


def _and_others(shares: Mapping[str, float], *parts: str) -> str:
    """Further parts of the gap that are worth a word, each behind a comma."""
    worth = [part for part in parts if _is_worth_naming(shares, part)]
    return "".join(f", {part} {percent(shares[part])}" for part in worth)


def _is_worth_naming(shares: Mapping[str, float], part: str) -> bool:
    return shares.get(part, 0.0) >= EVIDENCE.worth_naming


def is_above_floor(gap: Mapping[str, Any]) -> bool:
    """Whether a report's gap has an error left that is clearly no noise."""
    return bool(gap["after"] > EVIDENCE.clearly_above_floor * gap["floor"])


def effects_close_more(gap: Mapping[str, Any]) -> bool:
    """Whether the effects of an answer, on the declared parameters, close more of a gap than
    refitting without them; an older report does not say."""
    alone = gap.get("effects_only")
    same = gap.get("same_numbers", gap["before"])
    return alone is not None and bool(alone < min(gap["parameters_only"], same))


def waterfall(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The parts of the held-out squared error, the nominal model's being 1: what the answer's
    integration and start take, what refitting takes, each effect, what is left, the noise.

    Refitting and the effects stand in the order of what they close alone, the larger first: what
    both could close is counted for that one. Where neither closes anything alone, refitting comes
    first.

    What all effects take together is measured; it is split between several as each one's removal
    brings back. Where the verdict is an unknown effect, the nearest composition takes their place.
    In an older report refitting includes integration and start, or comes first. Empty where there
    is no gap.
    """
    gap = document["gap"]
    if gap["closed"] is None or not gap["before"] > 0.0:
        return []
    effects, unknown = document["effects"], document["verdict"] == "unknown_effect"
    same = gap.get("same_numbers", gap["before"])
    numbers = gap["parameters_only"] if effects or unknown else gap["after"]
    is_effects_first = effects_close_more(gap)
    first = gap["effects_only"] if is_effects_first else numbers
    levels = [1.0]
    for error in (same, first, gap["after"], gap["floor"]):
        levels.append(min((error / gap["before"]) ** 2, levels[-1]))
    taken = [high - low for high, low in pairwise(levels)]
    by_effects = taken[1 if is_effects_first else 2]
    back = sum(e["share"] for e in effects)
    parts = [(SAME_NUMBERS, False, taken[0])] if "same_numbers" in gap else []
    refitted = [(NEW_NUMBERS, False, taken[2 if is_effects_first else 1])]
    acting = [
        (name(e), True, by_effects * (e["share"] / back if back else 1.0 / len(effects)))
        for e in effects
    ]
    if unknown:
        acting = [*((what, True, 0.0) for what, _, _ in acting), (NEAREST, False, by_effects)]
    parts += acting + refitted if is_effects_first else refitted + acting
    parts += [(UNEXPLAINED, False, taken[3]), (NOISE, False, levels[-1])]
    return [{"what": what, "effect": is_effect, "share": share} for what, is_effect, share in parts]


def shares(document: Mapping[str, Any]) -> dict[str, float]:
    """What each part takes of the gap above the noise floor, by what it is called; empty where
    there is no gap."""
    parts: dict[str, float] = {}
    for part in waterfall(document):
        parts[part["what"]] = parts.get(part["what"], 0.0) + part["share"]
    whole = 1.0 - parts.pop(NOISE, 1.0)
    return {what: share / whole for what, share in parts.items()} if whole > 0.0 else {}


def _shares(document: Mapping[str, Any]) -> dict[str, float]:
    """`shares`, with the effects together."""
    named = set(map(name, document["effects"]))
    together: dict[str, float] = {}
    for what, share in shares(document).items():
        key = EFFECTS if what in named else what
        together[key] = together.get(key, 0.0) + share
    return together


def _with_estimate(entry: Mapping[str, Any]) -> str:
    words = name(entry) if "joint" in entry else f"{name(entry)} at the {entry['channel']}"
    if not entry["estimate"]:
        return words
    parameter, number = estimated(entry)[0]
    value = with_interval(number["value"], number["ci95"])
    return f"{words}, {label_of(parameter, number)} {value} {unit(number['unit'])}".rstrip() + ","


def estimated(entry: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """An effect's parameters with their estimates, in the order in which it declares them: the
    keys of stored JSON are sorted. An older report has the order of its keys."""
    estimate = entry["estimate"]
    return [(parameter, estimate[parameter]) for parameter in entry.get("parameters", estimate)]


def label_of(parameter: str, number: Mapping[str, Any]) -> str:
    """What a parameter is called; an older report has its name alone."""
    return str(number.get("label") or parameter.replace("_", " "))


def name(entry: Any) -> str:
    """An effect in words; where a report names its joint, at that joint."""
    effect, at = (
        (entry, None) if isinstance(entry, str) else (str(entry["effect"]), entry.get("joint"))
    )
    words = " ".join(PROPER.get(word, word) for word in effect.split("_"))
    words = HYPHENATED.get(effect, words)
    return f"{words} at {at}" if at else words


def composition(effects: Sequence[Any], nothing: str = "no effect") -> str:
    """Effects that act together, in words."""
    return " with ".join(map(name, effects)) or nothing


def number_name(entry: Mapping[str, Any]) -> str:
    """What a number of a report or of a study is called: an effect's with the effect, a parameter's
    with its symbol."""
    label = str(entry["label"]).replace("_", " ")
    if entry["effect"] is not None:
        return f"{name({k: entry[k] for k in ('effect', 'joint') if k in entry})} ({label})"
    has_symbol = f"{label} ".startswith(f"{entry['parameter']} ")
    return label if has_symbol else f"{label} {entry['parameter']}"


def some_of(names: Sequence[str], most: int) -> str:
    """Names with commas; of many the first, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"
