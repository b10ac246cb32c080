"""The fixed planner must not track worse with the candidate."""

from dataclasses import dataclass

from trueup.control.closed_loop import Tracking
from trueup.gate.rule import MEAN, Compared, Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class TrackingNoWorse(Rule):
    """In closed loop the mean squared tracking error stays within `slack` times the incumbent's,
    and the envelope is not breached more.

    A better prediction need not track better; what a robot feels is the tracking. The interval is
    over paired runs.
    """

    slack: float = 1.05
    require: str = MEAN
    name = "tracking_no_worse"
    closed_loop = True

    def __call__(self, trial: Trial) -> Verdict:
        runs = trial.tracking
        if runs is None:
            return Verdict(
                self.name,
                False,
                float("nan"),
                self.slack,
                "1",
                "there are no runs in closed loop",
                require=self.require,
            )
        compared = Compared(
            float(runs.candidate.mean()), float(runs.incumbent.mean()), lambda: _ratios(runs)
        )
        calm = runs.breaches[0] <= runs.breaches[1]
        because = (
            f"breaches {runs.breaches[0]:.4f} of the time, the incumbent "
            f"{runs.breaches[1]:.4f}; {len(runs.candidate)} paired runs"
        )
        return self.verdict(
            calm and self.within(compared, self.slack), compared, self.slack, because
        )


def _ratios(runs: Tracking) -> tuple[float, float] | None:
    """The interval of the ratio of the runs' errors, from that of their change."""
    change = runs.change_ci95()
    return None if change is None else (1.0 + change[0], 1.0 + change[1])
