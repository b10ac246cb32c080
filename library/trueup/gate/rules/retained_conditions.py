"""No condition that was covered before may be predicted worse."""

from dataclasses import dataclass

from trueup.gate.cells import cell_words
from trueup.gate.rule import MEAN, ROLLOUT, Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class RetainedConditions(Rule):
    """In every cell of the declared conditions, the mean rollout error stays within `slack` times
    the incumbent's.

    An update that is better on the whole may have forgotten a payload or a speed; the mean over all
    episodes would not show it.
    """

    slack: float = 1.05
    require: str = MEAN
    name = "retained_conditions"

    def __call__(self, trial: Trial) -> Verdict:
        cells = list(dict.fromkeys(trial.cells))
        each = [
            trial.compared(ROLLOUT, [i for i, c in enumerate(trial.cells) if c == cell])
            for cell in cells
        ]
        at = self.nearest(each, self.slack)
        worse = [
            cell_words(c, trial.conditions)
            for c, compared in zip(cells, each, strict=True)
            if not self.within(compared, self.slack)
        ]
        because = (
            f"worse in: {'; '.join(worse)}"
            if worse
            else f"nearest to its bound in: {cell_words(cells[at], trial.conditions)}"
        )
        return self.verdict(not worse, each[at], self.slack, because)
