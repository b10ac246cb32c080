"""Negative controls: models that no sound gate accepts. They are judged before the candidate is,
for a gate must be able to reject.

    incumbent    what serves, against itself: nothing is better
    copy         a candidate equal to it, loaded from its bytes again
    noise        what serves with noise added to what it predicts, as large as the signal and its
                 own error together

When a gate is declared there may be no episode yet. Then its rules are held against figures alone:
a candidate whose errors are the incumbent's has to be rejected, and one whose errors are ten times
as large has to fail every single rule.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.control.closed_loop import Tracking
from trueup.errors import BadGate
from trueup.fit.score import Missed, Score, Windowed, score_of
from trueup.gate.decision import Gate
from trueup.gate.rule import Trial, Verdict

Array = NDArray[np.float64]
FAR = 10.0  # times the incumbent's error: whoever allows for that allows for anything
SEED = 0
INCUMBENT, COPY, NOISE = "incumbent", "copy", "noise"
CALLED: Mapping[str, str] = {
    INCUMBENT: "the incumbent itself",
    COPY: "a candidate equal to the incumbent",
    NOISE: "the incumbent with noise added",
}
PAIRS = 4  # made-up windows, so that there is an interval


class VacuousGate(BadGate):
    """The gate accepts what no gate may accept."""

    code = "vacuous-gate"
    hint = (
        "Add what must be better, such as rollout_improves with a ratio of 1 or less, and "
        "keep every slack below 10. "
        "If it is meant so, declare it with `vacuous`: true and a reason in `because` "
        "(the command: --vacuous --because REASON)."
    )


def require_can_reject(gate: Gate) -> None:
    """Raises VacuousGate where the gate accepts made-up figures that no gate may accept, unless it
    declares itself vacuous."""
    if gate.vacuous:
        return
    if _accepts(judged(gate, _made_up(gate, 1.0))):
        raise VacuousGate(
            "it accepts a candidate with the incumbent's errors: no rule requires an improvement",
            control=COPY,
        )
    idle = [v.rule for v in judged(gate, _made_up(gate, FAR)) if v.passed]
    if idle:
        which = f"the rule{'s' * (len(idle) > 1)} {' and '.join(idle)}"
        raise VacuousGate(
            f"a candidate {FAR:g} times as wrong as the incumbent passes {which}",
            control=NOISE,
            rules=idle,
        )


def judged(gate: Gate, trial: Trial) -> tuple[Verdict, ...]:
    """Every rule's verdict on a trial."""
    return tuple(rule(trial) for rule in gate.rules)


def controls(
    gate: Gate, trial: Trial, missed: Sequence[Missed], copied: Score, scales: Array, spreads: Array
) -> dict[str, Json]:
    """How the gate judges each control in the place of the candidate of `trial`, in which the
    incumbent is compared with itself.

    `missed` are the incumbent's residuals in each episode, `copied` its score when it is loaded
    from its bytes again; `scales` and `spreads` `(channels,)` are the reporting scales and the
    standard deviations of what was observed. Raises VacuousGate where a control is accepted, unless
    the gate declares itself vacuous.
    """
    scores = {
        INCUMBENT: trial.incumbent,
        COPY: copied,
        NOISE: score_of(_noisy(missed, spreads), scales),
    }
    verdicts = {
        name: judged(gate, replace(trial, candidate=score)) for name, score in scores.items()
    }
    accepted = [name for name, each in verdicts.items() if _accepts(each)]
    if accepted and not gate.vacuous:
        raise VacuousGate(
            f"it accepts {' and '.join(CALLED[name] for name in accepted)}", control=accepted[0]
        )
    return {
        name: {"accepted": _accepts(each), "failed": [v.rule for v in each if not v.passed]}
        for name, each in verdicts.items()
    }


def _accepts(verdicts: Sequence[Verdict]) -> bool:
    return all(v.passed for v in verdicts)


def _made_up(gate: Gate, times: float) -> Trial:
    """A trial of one episode in which the candidate's errors are `times` the incumbent's."""
    one, many = np.ones(1), np.ones(PAIRS)
    both = [Score(one * k, one * k, (Windowed(many * k, many * k, many),)) for k in (times, 1.0)]
    tracking = Tracking(many * times, many, (0.0, 0.0), (1.0,))
    cell = (("",) * len(gate.conditions),)
    return Trial(both[0], both[1], ("0" * 64,), cell, gate.conditions, tracking)


def _noisy(missed: Sequence[Missed], spreads: Array) -> list[Missed]:
    """Residuals of a predictor whose predictions have noise added, as large as each channel's
    spread and its root mean square error together."""
    rng = np.random.default_rng(SEED)
    with np.errstate(over="ignore", invalid="ignore"):
        total = sum(float(m.inside.sum()) for m in missed)
        square = (
            np.sum(
                [
                    np.sum(np.where(m.inside[:, :, None], m.by, 0.0) ** 2, axis=(0, 1))
                    for m in missed
                ],
                axis=0,
            )
            / total
        )
        size = np.hypot(spreads, np.sqrt(square))
        return [Missed(m.by + size * rng.standard_normal(m.by.shape), m.inside) for m in missed]
