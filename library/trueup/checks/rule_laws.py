"""Laws of a gate rule: it answers deterministically, never passes not-a-number, and never refuses
because of a smaller error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from trueup.checks.law import require
from trueup.control.closed_loop import Tracking
from trueup.fit.score import Score
from trueup.gate.rule import BOUND, Rule, Trial

EPISODES, TRIALS = 4, 60
CELLS = (("none",), ("none",), ("2 kg",), ("2 kg",))  # of each episode


def _trials() -> Iterator[Trial]:
    rng = np.random.default_rng(3)
    names = tuple(f"{i:064x}" for i in range(EPISODES))
    for _ in range(TRIALS):
        candidate, incumbent = rng.lognormal(sigma=0.4, size=(2, 2, EPISODES))
        yield _trial(Score(*candidate), Score(*incumbent), names)


def _trial(candidate: Score, incumbent: Score, names: tuple[str, ...]) -> Trial:
    """A trial in two conditions, whose closed-loop errors are its rollout errors."""
    return Trial(
        candidate,
        incumbent,
        names,
        CELLS,
        ("payload",),
        tracking=Tracking(candidate.rollout, incumbent.rollout, (0.0, 0.0), (1.0,)),
    )


def the_same_trial_gives_the_same_verdict(rule: Rule) -> None:
    """A verdict depends on the trial alone."""
    for trial in _trials():
        require(rule(trial) == rule(trial), "the same trial gives the same verdict", rule.name)


def what_is_no_number_never_passes(rule: Rule) -> None:
    """One nan among the figures that a rule judges is refused, and all nan too."""
    nan = np.full(EPISODES, np.nan)
    for trial in _trials():
        for candidate in (
            Score(nan, nan),
            Score(np.full(EPISODES, np.inf), np.full(EPISODES, np.inf)),
        ):
            require(
                not rule(_trial(candidate, trial.incumbent, trial.episodes)).passed,
                "what is no number never passes",
                rule.name,
            )
        for at in range(EPISODES):
            spoiled = Score(trial.candidate.rollout.copy(), trial.candidate.one_step.copy())
            spoiled.rollout[at] = spoiled.one_step[at] = np.nan
            require(
                not rule(_trial(spoiled, trial.incumbent, trial.episodes)).passed,
                "what is no number never passes",
                rule.name,
            )


def a_smaller_error_never_turns_a_pass_into_a_refusal(rule: Rule) -> None:
    """If a candidate passes, one with smaller errors passes too."""
    rng = np.random.default_rng(4)
    for trial in _trials():
        better = Score(
            trial.candidate.rollout * rng.uniform(0.1, 1.0, EPISODES),
            trial.candidate.one_step * rng.uniform(0.1, 1.0, EPISODES),
        )
        law_holds = (
            not rule(trial).passed or rule(_trial(better, trial.incumbent, trial.episodes)).passed
        )
        require(law_holds, "a smaller error never turns a pass into a refusal", rule.name)


def it_can_refuse_and_it_can_pass(rule: Rule) -> None:
    """A rule refuses some trial and passes some other."""
    trial = next(_trials())
    far, near = (
        Score(f * trial.incumbent.rollout, f * trial.incumbent.one_step) for f in (10.0, 0.1)
    )
    require(rule(_trial(near, trial.incumbent, trial.episodes)).passed, "it can pass", rule.name)
    require(
        not rule(_trial(far, trial.incumbent, trial.episodes)).passed, "it can refuse", rule.name
    )


def a_larger_bound_never_turns_a_pass_into_a_refusal(rule: Rule) -> None:
    """A looser rule has a larger number: bounds are compared when one gate follows another."""
    bound = next(f.name for f in fields(rule))  # type: ignore[arg-type]
    larger = replace(rule, **{bound: 1.5 * getattr(rule, bound)})  # type: ignore[type-var]
    for trial in _trials():
        law_holds = not rule(trial).passed or larger(trial).passed
        require(law_holds, "a larger bound never turns a pass into a refusal", rule.name)


def requiring_the_bound_is_stricter(rule: Rule) -> None:
    """A trial that passes at the bound of its interval passes at the mean, and the verdict holds
    the interval."""
    strict = replace(rule, require=BOUND)  # type: ignore[type-var]
    for trial in _trials():
        at_bound = strict(trial)
        require(
            not at_bound.passed or rule(trial).passed, "requiring the bound is stricter", rule.name
        )
        require(
            not at_bound.passed or at_bound.ci95 is not None,
            "requiring the bound is stricter",
            rule.name,
        )


LAWS = (
    the_same_trial_gives_the_same_verdict,
    what_is_no_number_never_passes,
    a_smaller_error_never_turns_a_pass_into_a_refusal,
    it_can_refuse_and_it_can_pass,
    a_larger_bound_never_turns_a_pass_into_a_refusal,
    requiring_the_bound_is_stricter,
)
