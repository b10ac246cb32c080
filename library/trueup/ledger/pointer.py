"""The serving pointer: which artifact answers for a plant, and the only two ways in which it moves.

Rules:
- a generation is used once, and every move adds one;
- a move names the generation that it starts from, or it is refused;
- forward only by an accepted decision that was judged at that very generation, against the artifact
  that serves;
- back only to an artifact that served before, after its switchback test: to the last one, or to an
  older one that is named.
"""

from __future__ import annotations

from dataclasses import dataclass

from trueup.errors import LedgerError, PointerMoved


class NotAccepted(LedgerError):
    """The decision rejected its candidate."""

    code = "decision-rejected"
    hint = (
        "Read the decision's verdicts, then fit again or diagnose: what is missing is in "
        "the model or in the data, not in the gate."
    )


class NothingToRollBackTo(LedgerError):
    """No validated artifact served before this one."""

    code = "nothing-to-roll-back-to"
    hint = "The plant's first artifact is serving; promote a better one instead."


class NotToRollBackTo(LedgerError):
    """The pointer may not go back to that generation."""

    code = "not-to-roll-back-to"
    hint = "Name a generation of `GET …/serving/history` that served before this one."


@dataclass(frozen=True, slots=True)
class ServingPointer:
    """Which artifact serves, since when, and why: a decision, or None for a registration or a
    rollback."""

    plant: str
    generation: int
    artifact: str
    decision: str | None
    since: str


@dataclass(frozen=True, slots=True)
class JudgedDecision:
    """The fields of a decision that a move of the pointer depends on."""

    digest: str
    accepted: bool
    candidate: str
    incumbent: str
    generation: int


def promote(
    pointer: ServingPointer, decision: JudgedDecision, expected_generation: int, now: str
) -> ServingPointer:
    """The pointer moved to the decision's candidate. Raises PointerMoved, NotAccepted."""
    require_generation(pointer, expected_generation)
    if not decision.accepted:
        raise NotAccepted(decision=decision.digest)
    if (decision.generation, decision.incumbent) != (pointer.generation, pointer.artifact):
        raise PointerMoved(
            (
                f"the decision was judged at generation {decision.generation}, the pointer is at "
                f"{pointer.generation}"
            ),
            expected=decision.generation,
            found=pointer.generation,
        )
    return ServingPointer(
        pointer.plant, pointer.generation + 1, decision.candidate, decision.digest, now
    )


def roll_back(
    pointer: ServingPointer, previous: str | None, expected_generation: int, now: str
) -> ServingPointer:
    """The pointer moved back to the artifact that served before. Raises PointerMoved,
    NothingToRollBackTo."""
    require_generation(pointer, expected_generation)
    if previous is None:
        raise NothingToRollBackTo(plant=pointer.plant)
    return ServingPointer(pointer.plant, pointer.generation + 1, previous, None, now)


def require_generation(pointer: ServingPointer, expected: int) -> None:
    """Raises PointerMoved if the pointer is at another generation than expected."""
    if pointer.generation != expected:
        raise PointerMoved(
            f"generation {expected} was expected, {pointer.generation} is serving",
            expected=expected,
            found=pointer.generation,
        )
