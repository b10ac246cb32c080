"""Families of plants on the wire."""

from __future__ import annotations

from pydantic import BaseModel

from trueup_service.http.schemas.wire import Digest


class NumberInBox(BaseModel):
    """A number, the ends of its range, and whether it lies between them; null if it is not
    known."""

    low: float
    high: float
    value: float | None
    inside: bool | None


class InBox(BaseModel):
    """Whether all numbers lie in a box."""

    inside: bool | None
    numbers: dict[str, NumberInBox]


class Membership(BaseModel):
    """Where a plant lies: in the declared box of a model's family, and in the box of the samples
    that the model was fitted to. `family_box` is null where no family was declared."""

    artifact: Digest
    parameters: dict[str, float]
    family_box: InBox | None
    sample_box: InBox | None
