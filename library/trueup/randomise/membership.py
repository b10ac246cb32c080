"""Membership: whether a plant's numbers lie inside a box, number by number.

There are two boxes, and they are different answers. The *family box* is what was declared: where
draws may lie. The *sample box* is what was drawn: where training plants did lie. A plant may be
inside the first and outside the second.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.canonical import Json

Box = Mapping[str, tuple[float, float]]


def membership(box: Box, values: Mapping[str, float]) -> dict[str, Json]:
    """Whether values lie inside a box, bounds included, by name. A number of the box that has no
    value is not known, and `inside` is then None unless another one is outside."""
    rows: dict[str, Json] = {}
    answers: list[bool | None] = []
    for name, (low, high) in box.items():
        value = values.get(name)
        inside = None if value is None else low <= value <= high
        answers.append(inside)
        rows[name] = {"low": low, "high": high, "value": value, "inside": inside}
    whole = False if False in answers else None if None in answers else True
    return {"inside": whole, "numbers": rows}


def box_document(box: Box) -> dict[str, Json]:
    """A box as JSON."""
    return {name: [low, high] for name, (low, high) in box.items()}


def box_of_document(document: Mapping[str, Json]) -> dict[str, tuple[float, float]]:
    """The box that was written down."""
    written: Any = document
    return {name: (float(low), float(high)) for name, (low, high) in written.items()}
