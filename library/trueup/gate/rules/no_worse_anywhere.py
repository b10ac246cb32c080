"""No held-out episode may be predicted worse."""

from dataclasses import dataclass

from trueup.gate.rule import MEAN, ROLLOUT, Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class NoWorseAnywhere(Rule):
    """The rollout error on each held-out episode stays within `slack` times the incumbent's."""

    slack: float = 1.0
    require: str = MEAN
    name = "no_worse_anywhere"

    def __call__(self, trial: Trial) -> Verdict:
        each = [trial.compared(ROLLOUT, [i]) for i in range(len(trial.episodes))]
        at = self.nearest(each, self.slack)
        because = f"episode {trial.episodes[at][:12]} is the nearest to its bound or beyond"
        return self.verdict(
            all(self.within(compared, self.slack) for compared in each),
            each[at],
            self.slack,
            because,
        )
