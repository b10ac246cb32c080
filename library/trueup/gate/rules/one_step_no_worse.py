"""The one-step error must not rise."""

from dataclasses import dataclass

from trueup.gate.rule import MEAN, ONE_STEP, Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class OneStepNoWorse(Rule):
    """The mean error of the first predicted step is at most `slack` times the incumbent's."""

    slack: float = 1.0
    require: str = MEAN
    name = "one_step_no_worse"

    def __call__(self, trial: Trial) -> Verdict:
        compared = trial.compared(ONE_STEP)
        because = (
            f"one-step error {compared.candidate:.5g}, the incumbent's is {compared.incumbent:.5g}"
        )
        return self.verdict(self.within(compared, self.slack), compared, self.slack, because)
