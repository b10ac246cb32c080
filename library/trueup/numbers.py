"""Numbers of a tuning: a field with its value, its unit and the reason for it."""

from __future__ import annotations

from dataclasses import field
from typing import Any


def number(value: Any, unit: str, why: str) -> Any:
    """A field with its value, its unit and the reason for it."""
    return field(default=value, metadata={"unit": unit, "why": why})


def required(unit: str, why: str) -> Any:
    """A field without a value of its own, with its unit and the reason for it."""
    return field(metadata={"unit": unit, "why": why})
