"""The rollout error must fall below a share of the incumbent's."""

from dataclasses import dataclass

import numpy as np

from trueup.gate.rule import Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class RolloutImproves(Rule):
    """The mean rollout error over the held-out episodes is below `ratio` times the incumbent's."""

    ratio: float = 0.98
    name = "rollout_improves"

    def __call__(self, trial: Trial) -> Verdict:
        candidate, incumbent = float(np.mean(trial.candidate.rollout)), float(np.mean(trial.incumbent.rollout))
        passed = candidate < self.ratio * incumbent  # False if either is nan
        return Verdict(
            self.name, passed, candidate, self.ratio * incumbent, "1", f"rollout error {candidate:.5g}, the incumbent's is {incumbent:.5g}"
        )
