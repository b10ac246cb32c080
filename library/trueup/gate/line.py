"""Line: the gates of a plant in the order in which they were declared, of which the last one
judges.

People learn, so a plant may get another gate after candidates have been scored. It is never silent:

- the new gate names the one that it follows, and says why;
- what is looser in it is worked out from the two documents;
- every decision by it carries what was known when it was declared: how its candidate and its
  held-out episodes had been judged before;
- every decision says how its candidate and its episodes were selected: of how many, after how many
  other trials, and whether the candidate errs as one does that had been rejected or waited for its
  verdict.

Everything here is worked out from documents, so a server, an auditor's machine and whoever replays
the log say the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json

# trials by which people choose: of 20 candidates no better than the incumbent, one passes a test at
# 5 % by chance
HELD_OUT_USES = 20
SHORT = 12  # digits of a digest in a sentence
LONGEST_NAME = 63  # characters of a plant's name
TWICE = 2
NAMED = 2  # digests that a sentence names, before it counts
# relative: who errs so nearly alike in every episode is the same model; the default gate asks for
# twice that
SAME = 0.01
# candidates not accepted that are scored beside a new one, the newest; the log's verifier holds
# decisions to it
BESIDE = 20
# kinds of jobs that show how candidates do on episodes without any gate
SHOWING = ("compare", "openloop", "consistency")


@dataclass(frozen=True, slots=True)
class Past:
    """An earlier decision: its gate, plant, candidate and episodes, and the rules that failed."""

    decision: str
    plant: str
    gate: str
    candidate: str
    accepted: bool
    failed: tuple[str, ...]
    episodes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LooserThan:
    """A gate, by its digest, and in words what a later gate loosens."""

    gate: str
    looser: list[str]


def shown_candidates(request: Mapping[str, Any]) -> tuple[str, ...]:
    """The candidates whose errors a job of a kind in SHOWING shows."""
    if "versions" in request:
        return tuple(map(str, request["versions"]))
    return str(request["first"]), str(request["second"])


def past_of(decision: str, plant: str, document: Mapping[str, Any]) -> Past:
    """The fields of a decision's document that later decisions refer to."""
    failed = tuple(v["rule"] for v in document["verdicts"] if not v["passed"])
    return Past(
        decision,
        plant,
        document["gate"],
        document["candidate"],
        document["accepted"],
        failed,
        tuple(document["episodes"]),
    )


def known(
    plant: str,
    candidate: str,
    episodes: Sequence[str],
    before: Iterable[Past],
    compared: Sequence[str] = (),
) -> dict[str, Json]:
    """What was known of a candidate and its held-out episodes when a gate was declared.

    `before` are earlier decisions, in order, of the plant and of others on the same episodes;
    `compared` are the jobs that showed the candidate's errors on them without any gate.
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
            counted.setdefault((episode, past.plant, past.gate), [0, 0])[
                0 if past.accepted else 1
            ] += 1
    on: list[Json] = [
        {
            "episode": e,
            **({} if p == plant else {"plant": p}),
            "gate": g,
            "accepted": passed,
            "rejected": refused,
        }
        for (e, p, g), (passed, refused) in counted.items()
    ]
    return {"candidate": mine, "episodes": on, "compared": sorted(compared)}


def selection(held_out: int, accepted: int, rejected: int, comparisons: int) -> dict[str, Json]:
    """How a trial's candidate and episodes were selected, for its decision.

    `held_out` counts the plant's held-out episodes, `accepted` and `rejected` the decisions on its
    other candidates on any of the trial's episodes since the gate was declared, `comparisons` those
    of any of its versions on any of them at any time.
    """
    return {
        "held_out": held_out,
        "accepted": accepted,
        "rejected": rejected,
        "comparisons": comparisons,
    }


def looser(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """In words, what a gate lets pass that the one before it did not; both are documents."""
    old, new = _rules(before), _rules(after)
    reasons = [f"it drops the rule {name}" for name in old if name not in new]
    for name, rule in new.items():
        for bound, value in rule.items():
            former = old.get(name, {}).get(bound)
            if (
                isinstance(value, int | float)
                and isinstance(former, int | float)
                and value > former
            ):
                reasons.append(f"{bound} of {name} is {value:g}, was {former:g}")
        if old.get(name, {}).get("require") == "bound" and rule.get("require") != "bound":
            reasons.append(f"{name} requires the mean, no longer the bound of its interval")
    scoring = [g["scoring"] for g in (before, after)]
    if scoring[0]["horizon_s"] != scoring[1]["horizon_s"]:
        reasons.append(
            f"its horizon is {scoring[1]['horizon_s']:g} s, was {scoring[0]['horizon_s']:g} "
            "s: which is stricter cannot be told"
        )
    if scoring[0]["windows"] == "every" and scoring[1]["windows"] == "first":
        reasons.append("it scores the first window of each episode alone, no longer every one")
    gone = [c for c in before.get("conditions", ()) if c not in after.get("conditions", ())]
    if gone and "retained_conditions" in new:
        reasons.append(f"it no longer tells {' and '.join(gone)} apart")
    if budget_of(after) > budget_of(before):
        reasons.append(
            f"held-out episodes are good for {budget_of(after)} uses, were for {budget_of(before)}"
        )
    if after.get("vacuous") and not before.get("vacuous"):
        reasons.append("it may accept the incumbent itself")
    return reasons


def looser_than(
    line: Sequence[tuple[str, Mapping[str, Any]]], document: Mapping[str, Any]
) -> list[LooserThan]:
    """Each gate of a line that `document` is looser than, the newest first. `line` holds digests
    and documents, in order."""
    compared = [LooserThan(digest, looser(before, document)) for digest, before in reversed(line)]
    return [less for less in compared if less.looser]


def budget_of(document: Mapping[str, Any]) -> int:
    """How many trials may use a held-out episode of a gate before it is spent."""
    uses = document.get("held_out_uses")
    return HELD_OUT_USES if uses is None else int(uses)


def _rules(document: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    return {rule["rule"]: rule for rule in document["rules"]}


def disclosure(document: Mapping[str, Any]) -> str | None:
    """In a few sentences, what a reader of a decision must know: what was known when its gate was
    declared, and how its candidate and episodes were selected. None for a decision of an earlier
    version, which does not say."""
    if "known" not in document:
        return None
    return " ".join([disclosure_of(document["candidate"], document["known"]), *selected(document)])


def selected(document: Mapping[str, Any]) -> list[str]:
    """Sentences that say how a decision's candidate and episodes were selected, and what its gate
    lets pass; empty where there is nothing to disclose."""
    stated = document.get("selection")
    near = f"Its errors are within {100 * SAME:g} % of those of candidate"
    sentences = [
        f"{near} {name[:SHORT]}, which had been rejected or waited for its verdict."
        for name in alike(document)
    ]
    if stated is not None:
        count = len(document["episodes"])
        if count < stated["held_out"]:
            sentences.append(
                f"It was judged on {count} of the plant's {stated['held_out']} held-out episodes."
            )
        others = stated["accepted"] + stated["rejected"]
        if others:
            outcome = _outcomes(stated["accepted"], stated["rejected"])
            sentences.append(
                "Decisions on other candidates on these episodes since the gate was "
                f"declared: {outcome}."
            )
        if stated["comparisons"]:
            sentences.append(
                f"Comparisons had shown errors on these episodes {_often(stated['comparisons'])}."
            )
    most = max(document.get("uses", ()), default=1)
    if most > 1:
        sentences.append(
            "Over all plants, the most used of its held-out episodes had been used "
            f"{_often(most - 1)} before."
        )
    if any(control["accepted"] for control in document["figures"].get("controls", {}).values()):
        sentences.append(
            "The gate accepts the incumbent itself, its copy or noise: it was declared as "
            "one that may."
        )
    return sentences


def _outcomes(accepted: int, rejected: int) -> str:
    return f"accepted {_often(accepted)}, rejected {_often(rejected)}"


def _often(count: int) -> str:
    return ("never", "once", "twice")[count] if count <= TWICE else f"{count} times"


def alike(document: Mapping[str, Any]) -> list[str]:
    """Candidates scored beside a decision's own that err as it does. They had been rejected, or
    waited for their verdict."""
    figures, numbers = document.get("figures", {}), range(len(document["episodes"]))
    others = {
        name: _by_episode(beside, numbers) for name, beside in figures.get("beside", {}).items()
    }
    return [
        name
        for name, errors in others.items()
        if _all_near(_by_episode(figures["candidate"], numbers), errors)
    ]


def disclosure_of(candidate: str, known: Mapping[str, Any]) -> str:
    """What was known when a gate was declared, in words."""
    own = f"candidate {candidate[:SHORT]}"
    events = [
        f"{own} had {_outcome(past)} {_on(past['episodes'])} by gate {past['gate'][:SHORT]}"
        for past in known["candidate"]
    ]
    if known["compared"]:
        events.append(f"{own} had been compared on its episodes in job {_names(known['compared'])}")
    if events:
        return f"This gate was declared after {'; and after '.join(events)}."
    rejected, accepted = (
        sum(on[outcome] for on in known["episodes"]) for outcome in ("rejected", "accepted")
    )
    if rejected or accepted:
        number = len({on["episode"] for on in known["episodes"]})
        others = (
            f"others had been judged on {number} of its held-out episodes "
            f"({_outcomes(accepted, rejected)}, counted for each episode)"
        )
        return (
            f"This gate was declared before candidate {candidate[:SHORT]} was judged; by "
            f"then {others}{_elsewhere(known)}."
        )
    return (
        "When this gate was declared, no gate of this project had judged anything on the "
        "held-out episodes of this decision."
    )


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
    """Whether the candidates of two decisions made the same errors in every episode that both were
    judged on, one at least.

    A model that is packed anew, or registered under another name, has another digest and the same
    errors. Both gates must score alike, for figures of other windows do not compare.
    """
    return _all_near(
        *(
            _by_episode(document["figures"]["candidate"], document["episodes"])
            for document in (one, other)
        )
    )


def rejects(other: Mapping[str, Any], document: Mapping[str, Any], *, same_scoring: bool) -> bool:
    """Whether the rejection `other` is of the candidate of a decision: of itself, of one that errs
    as it does, or of the same model under another digest.

    Both are documents of decisions; `same_scoring` says whether their gates score alike.
    """
    own = other["candidate"] in (document["candidate"], *alike(document))
    return own or (same_scoring and same_model(other, document))


def _by_episode(figures: Mapping[str, Any], episodes: Iterable[Any]) -> dict[Any, tuple[Any, Any]]:
    return dict(
        zip(episodes, zip(figures["rollout"], figures["one_step"], strict=True), strict=True)
    )


def _all_near(one: Mapping[Any, tuple[Any, Any]], other: Mapping[Any, tuple[Any, Any]]) -> bool:
    """Whether two models err alike in every episode that both were judged on, one at least."""
    shared = one.keys() & other.keys()
    return bool(shared) and all(
        _near(a, b) for e in shared for a, b in zip(one[e], other[e], strict=True)
    )


def _near(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return False
    return abs(one - other) <= SAME * max(abs(one), abs(other))
