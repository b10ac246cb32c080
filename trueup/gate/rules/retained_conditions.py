"""No condition that was covered before may be predicted worse."""

from dataclasses import dataclass

import numpy as np

from trueup.gate.cells import told
from trueup.gate.rule import Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class RetainedConditions(Rule):
    """In every cell of the declared conditions, the mean rollout error stays within `slack` times the incumbent's.

    An update that is better on the whole may have forgotten a payload or a speed; the mean over all episodes would not show it.
    """

    slack: float = 1.05
    name = "retained_conditions"

    def __call__(self, trial: Trial) -> Verdict:
        cells = list(dict.fromkeys(trial.cells))
        inside = np.array([[c == cell for c in trial.cells] for cell in cells], np.float64)
        candidate, incumbent = ((inside @ s.rollout) / inside.sum(axis=1) for s in (trial.candidate, trial.incumbent))
        over = candidate - self.slack * incumbent
        at = int(np.argmax(over))  # argmax stops at a nan
        worse = [told(c, trial.conditions) for c, x in zip(cells, over, strict=True) if not x <= 0.0]
        because = f"worse in: {'; '.join(worse)}" if worse else f"nearest to its bound in: {told(cells[at], trial.conditions)}"
        return Verdict(self.name, not worse, float(candidate[at]), self.slack * float(incumbent[at]), "1", because)
