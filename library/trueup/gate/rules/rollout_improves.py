"""The rollout error must fall below a share of the incumbent's."""

from dataclasses import dataclass

from trueup.gate.rule import MEAN, ROLLOUT, Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class RolloutImproves(Rule):
    """The mean rollout error over the held-out episodes is below `ratio` times the incumbent's."""

    ratio: float = 0.98
    require: str = MEAN
    name = "rollout_improves"

    def __call__(self, trial: Trial) -> Verdict:
        compared = trial.compared(ROLLOUT)
        because = (
            f"rollout error {compared.candidate:.5g}, the incumbent's is {compared.incumbent:.5g}"
        )
        return self.verdict(
            self.within(compared, self.ratio, below=True), compared, self.ratio, because
        )
