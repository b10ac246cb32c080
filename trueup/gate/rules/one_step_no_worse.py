"""The one-step error must not rise."""

from dataclasses import dataclass

import numpy as np

from trueup.gate.rule import Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class OneStepNoWorse(Rule):
    """The mean error of the first predicted step is at most `slack` times the incumbent's."""

    slack: float = 1.0
    name = "one_step_no_worse"

    def __call__(self, trial: Trial) -> Verdict:
        candidate, incumbent = float(np.mean(trial.candidate.one_step)), float(np.mean(trial.incumbent.one_step))
        passed = candidate <= self.slack * incumbent  # False if either is nan
        return Verdict(
            self.name, passed, candidate, self.slack * incumbent, "1", f"one-step error {candidate:.5g}, the incumbent's is {incumbent:.5g}"
        )
