"""Update policy: what may happen to a plant's model without a person. It is frozen by its digest,
as a gate is."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.canonical import Json, is_digest
from trueup.errors import TrueupError
from trueup.gate.frozen import Frozen

SCHEMA = "trueup.policy/1"
ASK = "ask"
APPROVAL, FORBID = "approval", "forbid"
REQUIRE = "require"
MOST_APPROVALS = 5
LONGEST_H = 1e5  # eleven years
CHOICES = {
    "on_alarm": (ASK, "diagnose"),
    "on_diagnosis": (ASK, "judge"),
    "on_acceptance": (ASK, "promote"),
    "on_rejected": (APPROVAL, FORBID),
    "safeguards": (ASK, REQUIRE),
}
ADDED = (("on_rejected", APPROVAL), ("safeguards", ASK))  # fields with defaults, later than others


class BadPolicy(TrueupError):
    """The update policy cannot be followed."""

    code = "bad-policy"
    hint = (
        "A policy says ask, or diagnose, judge and promote, for its three steps, and names "
        "the gate that judges."
    )


@dataclass(frozen=True)
class UpdatePolicy(Frozen):
    """The three steps that may go on by themselves, the gate that judges, and what a new model's
    monitor promises.

    `on_alarm` ask or diagnose, `on_diagnosis` ask or judge, `on_acceptance` ask or promote. With
    `approvals` above one, a promotion takes that many people, and nothing is promoted without one.
    A candidate that was rejected before, and that no fresh episode speaks for, takes somebody
    else's `approval` with a reason, or `on_rejected` says forbid. Where `safeguards` says require,
    a recording of a machine is fitted, diagnosed and judged on only if its declared safeguards and
    stop criterion can be checked, and held. Raises BadPolicy.
    """

    gate: str
    on_alarm: str = "diagnose"
    on_diagnosis: str = "judge"
    on_acceptance: str = ASK
    promise_h: float = 100.0
    reference_episodes: int = (
        20  # healthy ones, recorded since the change, before a new model's monitor is calibrated
    )
    validate_every_h: float | None = None
    approvals: int = 1  # people that a promotion takes
    on_rejected: str = APPROVAL
    safeguards: str = ASK  # or require: what a recording of a machine must show to be used

    schema, refused, noun = SCHEMA, BadPolicy, "a policy"

    def document(self) -> dict[str, Json]:
        """The policy as JSON. Defaults of what older policies did not have are left out, so that
        these keep their digests."""
        document = super().document()
        return {name: value for name, value in document.items() if (name, value) not in ADDED}

    def __post_init__(self) -> None:
        for step, allowed in CHOICES.items():
            if getattr(self, step) not in allowed:
                raise BadPolicy(f"{step} must be {' or '.join(allowed)}", field=step)
        if not 1 <= self.approvals <= MOST_APPROVALS or (
            self.approvals > 1 and self.on_acceptance != ASK
        ):
            raise BadPolicy(
                "approvals must be 1 to 5; from 2 on, on_acceptance must be `ask`",
                field="approvals",
            )
        if not is_digest(self.gate):
            raise BadPolicy("the gate must be named by its digest", field="gate")
        hours = (
            self.promise_h,
            self.promise_h if self.validate_every_h is None else self.validate_every_h,
        )
        if not all(0.0 < h <= LONGEST_H for h in hours) or self.reference_episodes < 2:  # noqa: PLR2004  (halves)
            raise BadPolicy(
                (
                    "hours must be positive and no more than 100 000, and a reference needs two "
                    "episodes at least"
                ),
                field="promise_h",
            )
