"""Line: the gates of a plant in the order in which they were declared, of which the last one judges.

People learn, so a plant may get another gate after candidates have been scored. It is never silent:

- the new gate names the one that it follows, and says why;
- what is looser in it is worked out from the two documents;
- every decision by it carries what was known when it was declared: how its candidate and its held-out episodes had been judged before.

Everything here is worked out from documents, so a server, an auditor's machine and whoever replays the log say the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json

HELD_OUT_USES = 20  # trials by which people choose: of 20 candidates no better than the incumbent, one passes a test at 5 % by chance
SHORT = 12  # digits of a digest in a sentence
LONGEST_NAME = 63  # characters of a plant's name
NAMED = 2  # digests that a sentence names, before it counts
SAME = 1e-6  # relative: errors this near in every episode are those of one and the same model


@dataclass(frozen=True, slots=True)
class Past:
    """A decision that was made before: by which gate of which plant, on what, and which rules refused."""

    decision: str
    plant: str
    gate: str
    candidate: str
    accepted: bool
    failed: tuple[str, ...]
    episodes: tuple[str, ...]


def past_of(decision: str, plant: str, document: Mapping[str, Any]) -> Past:
    """What is remembered of a decision's document."""
    failed = tuple(v["rule"] for v in document["verdicts"] if not v["passed"])
    return Past(decision, plant, document["gate"], document["candidate"], document["accepted"], failed, tuple(document["episodes"]))


def known(plant: str, candidate: str, episodes: Sequence[str], before: Iterable[Past], compared: Sequence[str] = ()) -> dict[str, Json]:
    """What was known when a gate was declared, of a candidate and of the episodes that it is judged on.

    `before` are decisions made before that, in order, of the plant and of others on the same episodes; `compared` the jobs that showed the
    candidate's errors on them without any gate.
    """
    mine: list[Json] = []
    counted: dict[tuple[str, str, str], list[int]] = {}
    for past in before:
        shared = [e for e in episodes if e in past.episodes]
        if past.plant == plant and past.candidate == candidate:
            mine.append(
                {
                    "decision": past.decision,
                    "gate": past.gate,
                    "accepted": past.accepted,
                    "failed": list(past.failed),
                    "episodes": list(shared),
                }
            )
        for episode in shared:
            counted.setdefault((episode, past.plant, past.gate), [0, 0])[0 if past.accepted else 1] += 1
    on: list[Json] = [
        {"episode": e, **({} if p == plant else {"plant": p}), "gate": g, "accepted": passed, "rejected": refused}
        for (e, p, g), (passed, refused) in counted.items()
    ]
    return {"candidate": mine, "episodes": on, "compared": sorted(compared)}


def looser(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """What a gate lets pass that the one before did not, in words; both as documents."""
    old, new = _rules(before), _rules(after)
    found = [f"it drops the rule {name}" for name in old if name not in new]
    for name, rule in new.items():
        for bound, value in rule.items():
            held = old.get(name, {}).get(bound)
            if isinstance(value, int | float) and isinstance(held, int | float) and value > held:
                found.append(f"{bound} of {name} is {value:g}, was {held:g}")
        if old.get(name, {}).get("require") == "bound" and rule.get("require") != "bound":
            found.append(f"{name} requires the mean, no longer the bound of its interval")
    scoring = [g["scoring"] for g in (before, after)]
    if scoring[0]["horizon_s"] != scoring[1]["horizon_s"]:
        found.append(f"it scores over {scoring[1]['horizon_s']:g} s, no longer {scoring[0]['horizon_s']:g} s: figures do not compare")
    if scoring[0]["windows"] == "every" and scoring[1]["windows"] == "first":
        found.append("it scores the first window of each episode alone, no longer every one")
    gone = [c for c in before.get("conditions", ()) if c not in after.get("conditions", ())]
    if gone and "retained_conditions" in new:
        found.append(f"it no longer tells {' and '.join(gone)} apart")
    if budget_of(after) > budget_of(before):
        found.append(f"held-out episodes are good for {budget_of(after)} uses, were for {budget_of(before)}")
    if after.get("vacuous") and not before.get("vacuous"):
        found.append("it may accept the incumbent itself")
    return found


def budget_of(document: Mapping[str, Any]) -> int:
    """How many trials a gate's held-out episodes are good for."""
    given = document.get("held_out_uses")
    return HELD_OUT_USES if given is None else int(given)


def _rules(document: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    return {rule["rule"]: rule for rule in document["rules"]}


def disclosure(document: Mapping[str, Any]) -> str | None:
    """In a sentence or two what was known when a decision's gate was declared; None of a decision that does not tell."""
    if "known" not in document:
        return None
    return disclosure_of(document["candidate"], document["known"])


def disclosure_of(candidate: str, known: Mapping[str, Any]) -> str:
    """What was known when a gate was declared, in words."""
    own = f"candidate {candidate[:SHORT]}"
    said = [f"{own} had {_outcome(past)} {_on(past['episodes'])} by gate {past['gate'][:SHORT]}" for past in known["candidate"]]
    if known["compared"]:
        said.append(f"{own} had been compared on its episodes in job {_names(known['compared'])}")
    if said:
        return f"This rule was declared after {'; and after '.join(said)}."
    rejected, accepted = (sum(on[outcome] for on in known["episodes"]) for outcome in ("rejected", "accepted"))
    if rejected or accepted:
        number = len({on["episode"] for on in known["episodes"]})
        which = f"{number} of its held-out episodes {'has' if number == 1 else 'have'}"
        return (
            f"This rule was declared before candidate {candidate[:SHORT]} was judged; {which} judged others before it: "
            f"{accepted} times accepted, {rejected} times rejected{_elsewhere(known)}."
        )
    return "This rule was declared before anything was scored on its held-out episodes by a gate."


def _elsewhere(known: Mapping[str, Any]) -> str:
    others = sorted({on["plant"] for on in known["episodes"] if "plant" in on})
    return f", also for plant {_names(others, LONGEST_NAME)}" if others else ""


def _outcome(past: Mapping[str, Any]) -> str:
    return "passed" if past["accepted"] else f"failed {' and '.join(past['failed'])}"


def _on(episodes: Sequence[str]) -> str:
    if not episodes:
        return "on other episodes"
    return f"on episode{'s' * (len(episodes) != 1)} {_names(episodes)}"


def _names(digests: Sequence[str], digits: int = SHORT) -> str:
    named = ", ".join(d[:digits] for d in digests[:NAMED])
    return named if len(digests) <= NAMED else f"{named} and {len(digests) - NAMED} more"


def same_model(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether the candidates of two decisions' documents made the same errors in every episode that both were judged on, one at least.

    What is packed anew, or registered under another name, has another digest and the same errors. Figures of other windows do not compare;
    whoever calls has seen to it that both gates score alike.
    """
    errors = [_errors(document) for document in (one, other)]
    shared = errors[0].keys() & errors[1].keys()
    return bool(shared) and all(_near(a, b) for e in shared for a, b in zip(errors[0][e], errors[1][e], strict=True))


def _errors(document: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    figures = document["figures"]["candidate"]
    return dict(zip(document["episodes"], zip(figures["rollout"], figures["one_step"], strict=True), strict=True))


def _near(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return False
    return abs(one - other) <= SAME * max(abs(one), abs(other))
