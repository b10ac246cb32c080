"""The fixed planner must not track worse with the candidate."""

from dataclasses import dataclass

from trueup.gate.rule import Rule, Trial, Verdict


@dataclass(frozen=True, slots=True)
class TrackingNoWorse(Rule):
    """In closed loop the mean squared tracking error stays within `slack` times the incumbent's, and the envelope is not breached more.

    A better prediction need not track better; what a robot feels is the tracking.
    """

    slack: float = 1.05
    name = "tracking_no_worse"
    closed_loop = True

    def __call__(self, trial: Trial) -> Verdict:
        found = trial.tracking
        if found is None:
            return Verdict(self.name, False, float("nan"), self.slack, "1", "there are no runs in closed loop")
        candidate, incumbent = float(found.candidate.mean()), float(found.incumbent.mean())
        calm = found.breaches[0] <= found.breaches[1]
        because = f"breaches {found.breaches[0]:.4f} of the time, the incumbent {found.breaches[1]:.4f}; {len(found.candidate)} paired runs"
        passed = calm and candidate <= self.slack * incumbent  # False if either is nan
        return Verdict(self.name, passed, candidate, self.slack * incumbent, "1", because)
