"""Indistinguishable: effects that no command tells apart on some plants (aliases), and what would.

A delay of the actuator and one of the sensor on any loop's log; a constant force and a position
bias on a linear spring; a scale of the position and a skewed clock on a linear plant. Where one is
the answer the other is fitted too, from the same place, so that only what the log says parts them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from trueup.model.block import joint, kind, term
from trueup.model.hypothesis import Hypothesis

ALIASES: Mapping[frozenset[str], str] = {
    frozenset({"constant_force", "sensor_bias"}): (
        "compare the logged position with a gauge or an end stop at rest, or hold the joint "
        "by hand at a known place"
    ),
    frozenset({"sensor_scale", "clock_skew"}): (
        "compare the logged travel with a ruler over a known distance, or the log's clock "
        "with a second one"
    ),
    frozenset(
        {"actuator_delay", "sensor_delay"}
    ): "log the applied command or the motor current with the sensor's own clock",
}


def aliases(of: Hypothesis) -> Iterator[tuple[str, str]]:
    """Each effect of a composition that has a alias outside it, and the alias."""
    for pair in ALIASES:
        for at in of.effects:
            if kind(at).name in pair:
                alias = term(min(pair - {kind(at).name}), joint(at))
                if alias not in of.effects:
                    yield at, alias


def are_aliases(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two compositions differ in nothing but aliases at one joint."""
    differing = set(one.effects) ^ set(other.effects)
    return (
        len({joint(t) for t in differing}) == 1
        and frozenset(kind(t).name for t in differing) in ALIASES
    )


def how_to_part(one: Hypothesis, other: Hypothesis) -> str | None:
    """What would tell apart two compositions that differ in aliases alone."""
    return (
        ALIASES[frozenset(kind(t).name for t in set(one.effects) ^ set(other.effects))]
        if are_aliases(one, other)
        else None
    )
