"""Strategy: how a plant is diagnosed. It is chosen once, from the nominal model and from whether
the episodes are a machine's or a simulator's.

One joint of a family is cheap to roll out and has few parameters, so everything is tried. A robot
takes long, its joints move each other, and a rollout soon diverges from the log: terms are screened
where they show most, windows are as long as predictions, and their starts are found piece by piece.
"""

from __future__ import annotations

from dataclasses import dataclass

from trueup.diagnose.model_selection import SelectionCriteria
from trueup.model.plant import Plant

MANY_JOINTS = 4  # from so many on, a fit takes so long that fewer are made
PAIR = 2  # effects


@dataclass(frozen=True, slots=True)
class Effort:
    """How many terms and compositions go on at each step.

    screened    terms at the joint where a linear model expects most of one; 0 is all
    others      terms at the other joints
    fitted      of those screened, on whole windows; 0 is all
    converged   of those fitted, until nothing moves
    parents     best compositions that grow by one more term
    grown       most promising terms that each parent is tried with
    partners    compositions that come next, tried with a few terms
    """

    screened: int
    others: int
    fitted: int
    converged: int
    parents: int
    grown: int
    partners: int


ONE_JOINT = Effort(screened=0, others=0, fitted=0, converged=5, parents=4, grown=9, partners=0)
ROBOT = Effort(screened=0, others=4, fitted=5, converged=5, parents=2, grown=6, partners=4)
LARGE_ROBOT = Effort(screened=8, others=3, fitted=3, converged=2, parents=1, grown=4, partners=0)


@dataclass(frozen=True, slots=True)
class Strategy:
    """What differs between kinds of plants and of episodes, by name.

    effort              how many go on at each step
    robot               whether joints move each other
    thorough            whether fits are carried to a millionth of their cost: a joint's always,
                        for they are cheap; a robot's only on a simulator's log, whose laws hold so
                        exactly that it tells anything
    held_starts         whether windows start as observed while a search fits
    horizon_windows     whether windows are as long as predictions; else some seconds at least
    in_pieces           whether the starts of windows are found on pieces of them, since a long
                        window from a wrong start ends far away
    most_effects        how many effects a composition may have
    late_topics         whether a topic may be late beside so many effects
    physical            whether the episodes are a machine's
    may_be_trimmed      whether stretches that nothing explains may be put aside: of a machine with
                        one joint; a robot's errors are large wherever it is about to tip over
    """

    effort: Effort
    robot: bool
    thorough: bool
    held_starts: bool
    horizon_windows: bool
    in_pieces: bool
    most_effects: int
    late_topics: bool
    physical: bool
    may_be_trimmed: bool


def strategy_for(plant: Plant, criteria: SelectionCriteria) -> Strategy:
    """The strategy for a plant whose episodes are judged by some criteria."""
    dynamics = plant.dynamics
    return _of_robot(dynamics.joints, criteria) if dynamics.form.of_robot else _of_joint(criteria)


def _of_joint(criteria: SelectionCriteria) -> Strategy:
    return Strategy(
        effort=ONE_JOINT,
        robot=False,
        thorough=True,
        held_starts=criteria.of_machine,
        horizon_windows=criteria.of_machine,
        in_pieces=False,
        most_effects=criteria.most_effects,
        late_topics=criteria.of_machine,
        physical=criteria.of_machine,
        may_be_trimmed=criteria.of_machine,
    )


def _of_robot(joints: int, criteria: SelectionCriteria) -> Strategy:
    return Strategy(
        effort=ROBOT if joints < MANY_JOINTS else LARGE_ROBOT,
        robot=True,
        thorough=not criteria.of_machine,
        held_starts=False,
        horizon_windows=True,
        in_pieces=True,
        most_effects=PAIR,
        late_topics=False,
        physical=criteria.of_machine,
        may_be_trimmed=False,
    )
