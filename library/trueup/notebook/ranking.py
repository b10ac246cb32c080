"""The compositions that were tried, in the order in which a person wants them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def ranked(report: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The hypotheses of a report that were compared on held-out episodes: the answer, then the
    others by their reduced chi-square."""
    compared = [h for h in report["evidence"]["hypotheses"] if h.get("validation") is not None]
    return sorted(compared, key=lambda h: (not h.get("answer", False), h["validation"]))
