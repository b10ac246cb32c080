"""No held-out episode may be predicted worse."""

from dataclasses import dataclass

import numpy as np

from trueup.gate.rule import Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class NoWorseAnywhere(Rule):
    """The rollout error on each held-out episode stays within `slack` times the incumbent's."""

    slack: float = 1.0
    name = "no_worse_anywhere"

    def __call__(self, trial: Trial) -> Verdict:
        over = trial.candidate.rollout - self.slack * trial.incumbent.rollout  # a difference: an incumbent's error may be 0
        at = int(np.argmax(over))  # argmax stops at a nan; Python's max would pass over it
        candidate, bound = float(trial.candidate.rollout[at]), self.slack * float(trial.incumbent.rollout[at])
        return Verdict(
            self.name,
            bool((over <= 0.0).all()),
            candidate,
            bound,
            "1",
            f"episode {trial.episodes[at][:12]} is the nearest to its bound or beyond",
        )
