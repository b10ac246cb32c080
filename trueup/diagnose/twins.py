"""Twins: effects that no command tells apart on some plants, and what would.

A delay of the actuator and one of the sensor on any loop's log; a constant force and a position bias on a linear spring; a scale of the
position and a skewed clock on a linear plant. Where one is the answer the other is fitted too, from the same place, so that only what
the log says parts them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from trueup.model.hypothesis import Hypothesis

TWINS: Mapping[frozenset[str], str] = {
    frozenset(
        {"constant_force", "sensor_bias"}
    ): "compare the logged position with a gauge or an end stop at rest, or hold the joint by hand at a known place",
    frozenset(
        {"sensor_scale", "clock_skew"}
    ): "compare the logged travel with a ruler over a known distance, or the log's clock with a second one",
    frozenset({"actuator_delay", "sensor_delay"}): "log the applied command or the motor current with the sensor's own clock",
}


def twins(of: Hypothesis) -> Iterator[tuple[str, str]]:
    """Each effect of a composition that has a twin outside it, and the twin."""
    for pair in TWINS:
        inside, outside = pair & set(of.effects), pair - set(of.effects)
        if len(inside) == len(outside) == 1:
            yield min(inside), min(outside)
