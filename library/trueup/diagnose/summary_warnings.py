"""Summary warnings: what a reader of a report should know before its answer is used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.collect.step_warning import off_step
from trueup.diagnose.number_text import short
from trueup.diagnose.summary_text import (
    MOST_NUMBERS,
    MOST_RECORDINGS,
    UNNAMED,
    faults,
    number_name,
    recording_name,
    some_of,
)
from trueup.diagnose.tuning_of_answers import EVIDENCE


def warnings(document: Mapping[str, Any], names: Mapping[str, str] = UNNAMED) -> list[str]:
    """What a reader of the answer should know first, a sentence each: of pushes, the clock, new
    numbers that mislead, noise, the fit. `names` are those of recordings by digest."""
    push = "External force, as from a contact: {}. Leave this time out: contacts are not simulated."
    sentences = [
        *faults(document, names),
        *(push.format(when) for when in _pushed(document, names)),
    ]
    evidence, gap = document["evidence"], document["gap"]
    if evidence.get("served") == "nominal":
        sentences.append(
            "No correction that was tried predicts the held-out recordings better than the nominal "
            "model: this diagnosis therefore returns the nominal model."
        )
    if evidence.get("no_force"):
        sentences.append(
            "Effects that add a force at the joint, such as dry friction, were not tried: the "
            "simulator takes no force."
        )
    if evidence.get("kept_as_declared"):
        sentences.append(
            f"Kept as declared: {', '.join(evidence['kept_as_declared'])}. The recordings "
            "determine only combinations of these with other parameters."
        )
    if evidence.get("guessed"):
        sentences.append(f"Guessed, and confirmed by nobody: {'; '.join(evidence['guessed'])}.")
    # an older report does not say what its clock was
    episodes = evidence["episodes"] if "timestep_s" in evidence else []
    late = [
        (recording_name(e["sha256"], names), off)
        for e in episodes
        if (off := off_step(e["period_s"], evidence["timestep_s"]))
    ]
    if late:
        which = some_of([name for name, _ in late], MOST_RECORDINGS)
        which = "All recordings" if len(late) == len(episodes) > 1 else which
        is_or_are = "is" if len(late) == 1 else "are"
        first = "" if len({off for _, off in late}) == 1 else f"{late[0][0]} was "
        sentences.append(f"{which} {is_or_are} off the declared step: {first}{late[0][1]}.")
    if (
        gap["before"] > EVIDENCE.clearly_above_floor * gap["floor"]
        and gap["parameters_only"] > EVIDENCE.misleading * gap["before"]
    ):
        sentences.append(
            "Refitting the nominal parameters without the effects makes held-out predictions "
            f"worse ({short(gap['parameters_only'])}, was {short(gap['before'])}): "
            "do not use those parameters alone."
        )
    entries = document.get("between_recordings", ())  # an older report has none
    differ = [number_name(entry) for entry in entries if entry["widens"]]
    if differ:
        of_one = len(differ) == 1
        sentences.append(
            f"Recordings, each fitted alone, differ in {some_of(differ, MOST_NUMBERS)}: "
            f"{'its interval is' if of_one else 'their intervals are'} widened by the variance "
            "between recordings, so as to cover one more recording."
        )
    ramps = [name for name, h in evidence.get("holds", {}).items() if _found_to_be_ramp(h)]
    if ramps:
        sentences.append(
            f"With a first-order hold between samples of {' and '.join(ramps)} the nominal form "
            "explains much more than with steps. Declare it in plant.json "
            '(`"hold": "first_order"`).'
        )
    coloured = {
        channel: part for channel, part in evidence.get("noise_correlation", {}).items() if part
    }
    if coloured:
        parts = ", ".join(f"{part:.2g} in {channel}" for channel, part in coloured.items())
        sentences.append(
            f"Noise is correlated from one sample to the next ({parts}): weights, noise floor and "
            "intervals take that into account."
        )
    off = next((c["off"] for c in evidence.get("convergence", [])), None)
    if off is not None and off > EVIDENCE.off_minimum:
        sentences.append(
            f"The fit of the answer ended {short(off)} interval half-widths from its minimum: the "
            "cost function is too rough there to prove convergence."
        )
    return sentences


def _found_to_be_ramp(hold: Mapping[str, Any]) -> bool:
    return bool(hold["hold"] == "first_order" and not hold["declared"])


def _pushed(document: Mapping[str, Any], names: Mapping[str, str]) -> list[str]:
    """When something outside pushes a robot, in words."""
    roles = {e["sha256"]: e["role"] for e in document["evidence"]["episodes"]}
    phrases = []
    for push in document["where"].get("pushed", []):
        joints = " and ".join(
            f"{j['joint']} by {j['force']:.2g} (force over inertia)" for j in push["joints"]
        )
        which = f"{roles[push['episode']]} episode {recording_name(push['episode'], names)}"
        phrases.append(f"{which}, {push['from_s']:g} to {push['to_s']:g} s: {joints}")
    return phrases
