"""Strategy: how a plant is diagnosed, chosen once from its nominal model and from what its episodes
are of.

One joint of a family is cheap to roll out and has few numbers, so everything is tried. A robot's
tree takes long, its joints move each other, and it soon goes its own way: terms are screened where
they show most, windows are as long as predictions, and their starts are found piece by piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch

from trueup.diagnose.model_selection import SelectionCriteria
from trueup.model.dynamics import CompiledFamily, CompiledTree, Dynamics
from trueup.model.plant import Plant

MANY_JOINTS = 4  # from so many on, a fit takes so long that fewer are made
PAIR = 2  # effects


@dataclass(frozen=True, slots=True)
class Effort:
    """How many go on. 0 is all, but of partners none.

    Terms `screened` at the joint where a linear model expects most of one, and `others` at the
    other joints; of those screened so many are `fitted`, and `converged`; of the best compositions
    so many `parents` grow by one more term, each tried with the `grown` most promising, and so many
    `partners` that come next with a few.
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
    robot               whether the nominal form is a robot's tree: its joints move each other, a
                        fit takes long, and it falls where nothing holds it
    exact               whether laws hold so well that a fit to a millionth of its cost tells
                        anything
    held_starts         whether windows start as observed while a search fits
    horizon_windows     whether windows are as long as predictions; else some seconds at least
    in_pieces           whether windows' starts are found in pieces of them, since a long window
                        from a wrong start ends far away
    most_effects        how many effects a composition may have
    physical            whether the episodes are a machine's
    """

    effort: Effort
    robot: bool
    exact: bool
    held_starts: bool
    horizon_windows: bool
    in_pieces: bool
    most_effects: int
    physical: bool


def strategy_for(plant: Plant, criteria: SelectionCriteria) -> Strategy:
    """The strategy for a plant whose episodes are judged by some criteria."""
    return _strategy(plant.dynamics, criteria)


@singledispatch
def _strategy(dynamics: Dynamics, _: SelectionCriteria) -> Strategy:
    raise TypeError(type(dynamics).__name__)


@_strategy.register
def _of_joint(_: CompiledFamily, criteria: SelectionCriteria) -> Strategy:
    return Strategy(
        effort=ONE_JOINT,
        robot=False,
        exact=True,
        held_starts=criteria.of_machine,
        horizon_windows=criteria.of_machine,
        in_pieces=False,
        most_effects=criteria.most_effects,
        physical=criteria.of_machine,
    )


@_strategy.register
def _of_robot(dynamics: CompiledTree, criteria: SelectionCriteria) -> Strategy:
    return Strategy(
        effort=ROBOT if dynamics.joints < MANY_JOINTS else LARGE_ROBOT,
        robot=True,
        exact=not criteria.of_machine,
        held_starts=False,
        horizon_windows=True,
        in_pieces=True,
        most_effects=PAIR,
        physical=criteria.of_machine,
    )
