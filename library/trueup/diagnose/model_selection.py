"""Model selection: which composition the evidence supports, from which others it cannot be
distinguished, and whether any composition does.

- Comparisons are of squared normalised errors, window by window, over the episodes that were fitted
  and those that were not; a larger composition must also earn its place on the latter alone.
- Differences are scaled by the best candidate's reduced chi-square: errors that no candidate
  explains count as noise. Every free number has its price.
- A larger composition is taken where it removes a material part of the gap, beyond the accuracy of
  laws and integration, or leaves nothing but noise of what plainly was there.
- Compositions of one size are told apart where a difference is certain over windows, and not where
  it is small.
- Where even the best leaves a material part of the gap, none of them is the answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.indistinguishable import are_aliases
from trueup.diagnose.measure import Gap
from trueup.diagnose.tuning import SELECTION
from trueup.episode.episode import Episode, is_physical
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import kind
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.numbers import number, required


@dataclass(frozen=True, slots=True)
class SelectionCriteria:
    """How exact a law may be expected to be.

    Where `alike` is not 0, what remains is no white noise, samples are no independent witnesses,
    and only validation episodes rank. `of_machine` says whether the recordings are a machine's.
    """

    material: float = required("of the refitted gap", "The least that an effect must remove.")
    finishing: float = required(
        "of the refitted gap", "The least where the effect leaves hardly anything of the rest."
    )
    overall: float = required(
        "of the nominal model's gap", "The least that an effect must remove of it."
    )
    unexplained: float = required("of the gap", "Where more is left, no law is the answer.")
    unexplained_by_more: float = required(
        "of the gap, for each number",
        "The limit of several effects: many numbers take up much.",
    )
    most_effects: int = required("effects", "How many are looked for.")
    alike: float = required(
        "of the best reduced chi-square",
        "Compositions of one size that differ by less on validation episodes are alike.",
    )
    indifferent: float = required(
        "of the refitted gap", "By so much integration alone may make one of two better."
    )
    far: float = number(np.inf, "reduced chi-square", "Beyond it the search goes on in any case.")
    of_machine: bool = number(False, "", "Whether the recordings are a machine's.")


SIMULATED = SelectionCriteria(  # the laws' forms and the integration differ by about a thousandth
    material=0.004,
    finishing=0.001,
    overall=2e-4,
    unexplained=0.012,
    unexplained_by_more=0.015,
    most_effects=3,
    alike=0.0,
    indifferent=0.0,
)
# A step of several joints knows an effect's force only when it is over.
ROBOT = replace(SIMULATED, finishing=3e-3, unexplained_by_more=0.03, indifferent=4e-4, far=10.0)
PHYSICAL = SelectionCriteria(  # no textbook law holds on a machine to better than some per cent
    material=0.01,
    finishing=0.01,
    overall=2e-3,
    unexplained=0.15,
    unexplained_by_more=0.6,
    most_effects=2,
    alike=0.25,
    indifferent=0.0,
    of_machine=True,
)


def selection_criteria(plant: Plant, episodes: Sequence[Episode]) -> SelectionCriteria:
    """By the stage that the episodes declare: a machine is measured more coarsely than a simulator,
    and a robot than a joint.

    Asked once in a diagnosis, of the episodes that it fits and compares on.
    """
    if is_physical(episodes):
        return PHYSICAL
    return ROBOT if plant.form.of_robot else SIMULATED


class Conclusion(StrEnum):
    """What a diagnosis ends in."""

    EFFECT = "effect"
    PARAMETERS_ONLY = "parameters_only"
    NO_GAP = "no_gap"
    UNKNOWN = "unknown_effect"


@dataclass(frozen=True, slots=True)
class Choice:
    """The verdict, the winner, what cannot be told from it, and the part of the gap that it
    leaves; a `partial` winner certainly acts, and leaves more than an answer may."""

    verdict: Conclusion
    winner: Candidate
    rivals: tuple[Candidate, ...]
    left: float
    partial: bool = False


def select(
    candidates: Sequence[Candidate],
    nominal: RolloutFit,
    criteria: SelectionCriteria = SIMULATED,
    level: Callable[[Candidate], float] = lambda _: 1.0,
) -> Choice:
    """Choose among fitted candidates, the bare family among them. `nominal` is the nominal model on
    validation episodes.

    `level` is the reduced chi-square that noise alone leaves a candidate on those: 1, and more
    where they happen to hold outliers.
    """
    ranked = _ranked(candidates, criteria)
    base, winner = ranked[0][0], ranked[0][0]
    gap = max(base.reduced_chi_square - 1.0, 0.0)
    if np.isfinite(nominal.reduced_chi_square):
        gap = max(gap, nominal.reduced_chi_square - 1.0)
    known = {c.hypothesis: c for group in ranked.values() for c in group}
    for _, group in sorted(ranked.items())[1:]:
        changed = known.get(_common(group[0], winner), base)
        if _earns(group[0], winner, changed, gap, criteria):
            winner = group[0]
    size = complexity(winner)
    whole = base.reduced_chi_square - 1.0 if size else gap
    left = max(winner.reduced_chi_square - 1.0, 0.0) / max(whole, 1e-12)
    bearable = _bearable(winner, base, criteria)
    if winner.reduced_chi_square > SELECTION.adequate and left > bearable:
        noise = level(winner)
        left *= max(winner.reduced_chi_square - noise, 0.0) / (winner.reduced_chi_square - 1.0)
        if winner.reduced_chi_square > SELECTION.adequate * noise and left > bearable:
            return Choice(Conclusion.UNKNOWN, winner, (), left)
    if not size:
        better = _improves(base, nominal)
        return Choice(
            Conclusion.PARAMETERS_ONLY if better else Conclusion.NO_GAP,
            winner,
            (),
            left,
        )
    rivals = tuple(
        c for c in ranked[size] if c is not winner and not _told_apart(c, winner, base, criteria)
    )
    return Choice(Conclusion.EFFECT, winner, rivals, left)


def _ranked(
    candidates: Sequence[Candidate], criteria: SelectionCriteria
) -> dict[float, list[Candidate]]:
    """Candidates that did not run away by their complexity, the best of each first."""
    sound = [c for c in candidates if np.isfinite(c.total)]
    spread = max(min(c.total for c in sound), SELECTION.least_chi_square)

    def rank(c: Candidate) -> float:
        return c.reduced_chi_square if criteria.alike else penalised(c, spread)

    ranked: dict[float, list[Candidate]] = {}
    for c in sorted(sound, key=rank):
        ranked.setdefault(complexity(c), []).append(c)
    return ranked


def _bearable(winner: Candidate, base: Candidate, criteria: SelectionCriteria) -> float:
    """The part of the gap that an answer may leave."""
    if len(winner.hypothesis.effects) <= 1:
        return criteria.unexplained
    numbers = len(winner.fit.free.rows) - len(base.fit.free.rows)
    return min(criteria.unexplained, criteria.unexplained_by_more / numbers)


def _improves(base: Candidate, nominal: RolloutFit) -> bool:
    """Whether the refitted nominal form is certainly better than the nominal model."""
    noise = max(base.reduced_chi_square, SELECTION.least_chi_square)
    removed = nominal.reduced_chi_square - base.reduced_chi_square
    worse = np.nan_to_num(nominal.costs - base.check.costs, nan=0.0)
    return removed > SELECTION.noise_power * noise and _certain(worse, base.reduced_chi_square)


def agreeing(choice: Choice, gap: Gap) -> Choice:
    """The choice where held-out predictions do not gainsay it: where they are at the floor of the
    noise, no gap is left unexplained, and where those of the nominal model were, there was none.
    """
    if gap.was_at_the_floor:
        return replace(choice, verdict=Conclusion.NO_GAP, rivals=())
    if choice.verdict is Conclusion.UNKNOWN and gap.at_the_floor:
        return replace(
            choice,
            verdict=Conclusion.EFFECT
            if choice.winner.hypothesis.effects
            else Conclusion.PARAMETERS_ONLY,
        )
    return choice


def complexity(c: Candidate) -> float:
    """Number of effects; one that contains another is half an effect more."""
    return sum(1.5 if kind(t).contains else 1.0 for t in c.hypothesis.effects)


def numbers_of(c: Candidate) -> int:
    """How many numbers a candidate's fit moves, what hidden states begin with among them."""
    return len(c.fit.free.rows) + sum(len(s.memory) for s in c.fit.starts.values())


def penalised(c: Candidate, spread: float) -> float:
    """Cost in units of what the best leaves, and a price for each free number.

    Source: G. Schwarz, Annals of Statistics 6 (1978).
    """
    return (c.fit.cost + c.check.cost) / spread + numbers_of(c) * float(
        np.log(c.fit.samples + c.check.samples)
    )


def nothing_left(candidate: Candidate, base: Candidate, criteria: SelectionCriteria) -> bool:
    """Whether nothing material is left for a larger composition to explain."""
    return (
        candidate.reduced_chi_square < SELECTION.adequate
        or candidate.reduced_chi_square - 1.0 < criteria.finishing * (base.reduced_chi_square - 1.0)
    )


def _common(larger: Candidate, smaller: Candidate) -> Hypothesis:
    """What a composition leaves of a smaller one that it changes, against which the change is
    measured; nothing where it adds to it."""
    kept = tuple(t for t in larger.hypothesis.effects if t in smaller.hypothesis.effects)
    return Hypothesis(kept if len(kept) < len(smaller.hypothesis.effects) else ())


def _earns(
    larger: Candidate, smaller: Candidate, base: Candidate, gap: float, criteria: SelectionCriteria
) -> bool:
    """Whether a larger composition removes a material and certain part of the gap on validation
    episodes."""
    after, before = larger.reduced_chi_square, smaller.reduced_chi_square
    removed = before - after
    rest = max(after - 1.0, 0.0) / max(before - 1.0, 1e-12)
    part = criteria.material if rest > SELECTION.finished else criteria.finishing
    material = SELECTION.noise_power * max(after, SELECTION.least_chi_square)
    finishes = after < SELECTION.adequate or rest < SELECTION.scraps
    all_is_explained = finishes and removed >= SELECTION.clearly_no_noise * after
    if criteria.alike or not all_is_explained:
        material = max(part * (base.reduced_chi_square - 1.0), criteria.overall * gap, material)
    return removed > material and _certain(smaller.check.costs - larger.check.costs, after)


def _told_apart(
    rival: Candidate, winner: Candidate, base: Candidate, criteria: SelectionCriteria
) -> bool:
    """Whether the windows of all episodes are certain that a rival of the same size is worse,
    numbers of parameters accounted for."""
    if criteria.alike:
        return rival.reduced_chi_square > (1.0 + criteria.alike) * winner.reduced_chi_square
    next_to = rival.total < SELECTION.next_to * winner.total
    if next_to and are_aliases(rival.hypothesis, winner.hypothesis):
        return False
    by_integration = criteria.indifferent * (base.total - winner.total)
    if criteria.indifferent and rival.total - winner.total < by_integration:
        return False
    worse = np.concatenate(
        [rival.fit.costs - winner.fit.costs, rival.check.costs - winner.check.costs]
    )
    spread = max(winner.total, SELECTION.least_chi_square)
    priced = (penalised(rival, spread) - penalised(winner, spread)) / 2.0
    separated = priced > SELECTION.log_likelihood
    return separated and (_agree(worse) or priced > SELECTION.certain * SELECTION.log_likelihood)


def _certain(worse: np.ndarray, reduced_chi_square: float) -> bool:
    """Whether windows agree that the first is worse, and by enough."""
    log_likelihood = float(worse.sum()) / 2.0 / max(reduced_chi_square, SELECTION.least_chi_square)
    return log_likelihood > SELECTION.log_likelihood and _agree(worse)


def _agree(worse: np.ndarray) -> bool:
    """Whether what speaks for the difference outweighs what speaks against it."""
    against = float(-worse[worse < 0.0].sum())
    return float(worse[worse > 0.0].sum()) > SELECTION.agreement * against
