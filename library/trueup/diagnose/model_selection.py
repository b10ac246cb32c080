"""Model selection: which composition the evidence supports, from which others it cannot be
distinguished, and whether any composition does.

- Comparisons are of squared normalised errors, window by window, over the episodes that were fitted
  and those that were not; a larger composition must also earn its place on the latter alone.
- Differences are scaled by the best candidate's own misfit, so that what no candidate explains does
  not separate them, and every free number has its price.
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
from trueup.episode.episode import Episode, is_physical
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import kind
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant

LOG_LIKELIHOOD = 9.0  # units of log-likelihood that separate two candidates
CERTAIN = 3.0  # times that, for windows that do not agree
AGREEMENT = 3.0  # of the evidence in windows for a difference to that against it
NEXT_TO = 1.02  # times the misfit: so near are twins, but for where their fits stopped
FLOOR = 0.5  # the least misfit: the noise is known to a few per cent, so none is far below 1
FINISHED = 0.2  # of what was left: a composition that leaves no more than that explains it
NOISE_POWER = 0.06  # of the noise's power: the least that an effect must remove
ADEQUATE = 1.25  # misfit up to which noise, known to a few per cent, is all that is left
PLAIN = 0.5  # of that misfit: so much more is no noise
SCRAPS = 0.1  # of what was left: an accident takes not so much of it
# times the noise's power: what a robot's law leaves of that size may be another effect, however
# large the gap was
FAR = 10.0


@dataclass(frozen=True, slots=True)
class SelectionCriteria:
    """How exact a law may be expected to be.

    `material` is the least part of the refitted gap that an effect must remove, `finishing` the
    same where it leaves FINISHED of the rest; `overall` the least part of the nominal model's gap;
    `unexplained` the part of the gap beyond which no law is the answer, and `unexplained_by_more`
    the same of several, for each of their numbers: many numbers take up much; `most_effects` how
    many are looked for; `alike` the part of the best misfit on validation episodes within which two
    compositions of one size are alike; `indifferent` the part of the refitted gap by which
    integration alone may make one of two better; `far` the misfit beyond which the search goes on
    in any case. Where `alike` is not 0, what remains is no white noise, samples are no independent
    witnesses, and only validation episodes rank. `of_machine` says whether the recordings are a
    machine's.
    """

    material: float
    finishing: float
    overall: float
    unexplained: float
    unexplained_by_more: float
    most_effects: int
    alike: float
    indifferent: float
    far: float = np.inf
    of_machine: bool = False


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
ROBOT = replace(SIMULATED, finishing=3e-3, unexplained_by_more=0.03, indifferent=4e-4, far=FAR)
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
    return ROBOT if len(plant.joints) > 1 else SIMULATED


class Verdict(StrEnum):
    """What a diagnosis ends in."""

    EFFECT = "effect"
    PARAMETERS_ONLY = "parameters_only"
    NO_GAP = "no_gap"
    UNKNOWN = "unknown_effect"


@dataclass(frozen=True, slots=True)
class Choice:
    """The verdict, the winner, what cannot be told from it, and the part of the gap that it
    leaves."""

    verdict: Verdict
    winner: Candidate
    rivals: tuple[Candidate, ...]
    left: float


def select(
    candidates: Sequence[Candidate],
    nominal: RolloutFit,
    criteria: SelectionCriteria = SIMULATED,
    level: Callable[[Candidate], float] = lambda _: 1.0,
) -> Choice:
    """Choose among fitted candidates, the bare family among them. `nominal` is the nominal model on
    validation episodes.

    `level` is the misfit that noise alone leaves a candidate on those: 1 but where they happen to
    hold outliers.
    """
    sound = [c for c in candidates if np.isfinite(c.total)]
    spread = max(min(c.total for c in sound), FLOOR)
    by_size: dict[float, list[Candidate]] = {}
    for c in sorted(
        sound, key=lambda c: c.reduced_chi_square if criteria.alike else penalised(c, spread)
    ):
        by_size.setdefault(complexity(c), []).append(c)
    base = by_size[0][0]
    gap = max(
        base.reduced_chi_square - 1.0,
        nominal.reduced_chi_square - 1.0 if np.isfinite(nominal.reduced_chi_square) else 0.0,
        0.0,
    )
    winner = base
    found = {c.hypothesis: c for c in sound}
    for _, group in sorted(by_size.items())[1:]:
        if _earns(group[0], winner, found.get(_common(group[0], winner), base), gap, criteria):
            winner = group[0]
    size = complexity(winner)
    left = max(winner.reduced_chi_square - 1.0, 0.0) / max(
        base.reduced_chi_square - 1.0 if size else gap, 1e-12
    )
    several = len(winner.hypothesis.effects) > 1
    numbers = len(winner.fit.free.rows) - len(base.fit.free.rows)
    bearable = (
        min(criteria.unexplained, criteria.unexplained_by_more / numbers)
        if several
        else criteria.unexplained
    )
    if winner.reduced_chi_square > ADEQUATE and left > bearable:
        noise = level(winner)
        left *= max(winner.reduced_chi_square - noise, 0.0) / (winner.reduced_chi_square - 1.0)
        if winner.reduced_chi_square > ADEQUATE * noise and left > bearable:
            return Choice(Verdict.UNKNOWN, winner, (), left)
    if size:
        rivals = tuple(
            c
            for c in by_size[size]
            if c is not winner and not _told_apart(c, winner, base, criteria)
        )
        return Choice(Verdict.EFFECT, winner, rivals, left)
    moved = nominal.reduced_chi_square - base.reduced_chi_square > NOISE_POWER * max(
        base.reduced_chi_square, FLOOR
    )
    better = moved and _certain(
        np.nan_to_num(nominal.costs - base.check.costs, nan=0.0), base.reduced_chi_square
    )
    return Choice(Verdict.PARAMETERS_ONLY if better else Verdict.NO_GAP, winner, (), left)


def agreeing(choice: Choice, gap: Gap) -> Choice:
    """The choice where held-out predictions do not gainsay it: where they are at the floor of the
    noise, no gap is left unexplained, and where those of the nominal model were, there was none.
    """
    if gap.was_at_the_floor:
        return replace(choice, verdict=Verdict.NO_GAP, rivals=())
    if choice.verdict is Verdict.UNKNOWN and gap.at_the_floor:
        return replace(
            choice,
            verdict=Verdict.EFFECT if choice.winner.hypothesis.effects else Verdict.PARAMETERS_ONLY,
        )
    return choice


def complexity(c: Candidate) -> float:
    """Number of effects; one that contains another is half an effect more."""
    return sum(1.5 if kind(t).contains else 1.0 for t in c.hypothesis.effects)


def penalised(c: Candidate, spread: float) -> float:
    """Cost in units of what the best leaves, and a price for each free number.

    Source: G. Schwarz, Annals of Statistics 6 (1978).
    """
    numbers = len(c.fit.free.rows) + sum(len(s.memory) for s in c.fit.starts.values())
    return (c.fit.cost + c.check.cost) / spread + numbers * float(
        np.log(c.fit.samples + c.check.samples)
    )


def nothing_left(candidate: Candidate, base: Candidate, criteria: SelectionCriteria) -> bool:
    """Whether nothing material is left for a larger composition to explain."""
    return (
        candidate.reduced_chi_square < ADEQUATE
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
    removed = smaller.reduced_chi_square - larger.reduced_chi_square
    rest = max(larger.reduced_chi_square - 1.0, 0.0) / max(smaller.reduced_chi_square - 1.0, 1e-12)
    part = criteria.material if rest > FINISHED else criteria.finishing
    material = NOISE_POWER * max(larger.reduced_chi_square, FLOOR)
    finishes = larger.reduced_chi_square < ADEQUATE or rest < SCRAPS
    if (
        criteria.alike or not finishes or removed < PLAIN * larger.reduced_chi_square
    ):  # else nothing is left of what plainly was
        material = max(part * (base.reduced_chi_square - 1.0), criteria.overall * gap, material)
    return removed > material and _certain(
        smaller.check.costs - larger.check.costs, larger.reduced_chi_square
    )


def _told_apart(
    rival: Candidate, winner: Candidate, base: Candidate, criteria: SelectionCriteria
) -> bool:
    """Whether the windows of all episodes are certain that a rival of the same size is worse,
    numbers of parameters accounted for."""
    if criteria.alike:
        return rival.reduced_chi_square > (1.0 + criteria.alike) * winner.reduced_chi_square
    if are_aliases(rival.hypothesis, winner.hypothesis) and rival.total < NEXT_TO * winner.total:
        return False
    if criteria.indifferent and rival.total - winner.total < criteria.indifferent * (
        base.total - winner.total
    ):
        return False
    worse = np.concatenate(
        [rival.fit.costs - winner.fit.costs, rival.check.costs - winner.check.costs]
    )
    spread = max(winner.total, FLOOR)
    priced = penalised(rival, spread) - penalised(winner, spread)
    return priced > 2.0 * LOG_LIKELIHOOD and (
        _agree(worse) or priced > CERTAIN * LOG_LIKELIHOOD * 2.0
    )


def _certain(worse: np.ndarray, misfit: float) -> bool:
    """Whether windows agree that the first is worse, and by enough."""
    return float(worse.sum()) / 2.0 / max(misfit, FLOOR) > LOG_LIKELIHOOD and _agree(worse)


def _agree(worse: np.ndarray) -> bool:
    """Whether what speaks for the difference outweighs what speaks against it."""
    return float(worse[worse > 0.0].sum()) > AGREEMENT * float(-worse[worse < 0.0].sum())
