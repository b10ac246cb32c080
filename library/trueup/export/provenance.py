"""Provenance: what a file says of the diagnosis that its model comes from: its sentence, the
numbers with their intervals, and the explanations that the recordings cannot tell from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json
from trueup.diagnose.summary_text import composition, estimated, sentence


@dataclass(frozen=True, slots=True)
class Provenance:
    """A diagnosis's answer in words, its intervals by the name of the number: value, lower and
    upper end in their unit; and the explanations that it cannot be told from."""

    answer: str
    intervals: Mapping[str, tuple[float, float, float, str]]
    alternatives: tuple[str, ...]

    @staticmethod
    def of(report: Mapping[str, Any]) -> Provenance:
        """What a report says."""
        intervals = {
            name: (number["value"], *number["ci95"], "")
            for name, number in report["parameters"].items()
        }
        for entry in report["effects"]:
            at = f" at {entry['joint']}" if "joint" in entry else ""
            intervals |= {
                f"{entry['effect']}{at}, {name}": (number["value"], *number["ci95"], number["unit"])
                for name, number in estimated(entry)
            }
        alternatives = tuple(composition(other) for other in report["indistinguishable"])
        return Provenance(sentence(report), intervals, alternatives)

    def document(self) -> dict[str, Json]:
        """What it says, as JSON."""
        return {
            "answer": self.answer,
            "intervals": [
                {"name": name, "value": value, "ci95": [low, high], "unit": unit}
                for name, (value, low, high, unit) in self.intervals.items()
            ],
            "alternatives": list(self.alternatives),
        }

    def lines(self) -> list[str]:
        """What it says, a line each."""
        return [
            self.answer,
            *(f"the recordings cannot tell this from: {x}" for x in self.alternatives),
            *(
                f"{name}: {value:.6g} {unit}".rstrip() + f", 95 % interval {low:.6g} to {high:.6g}"
                for name, (value, low, high, unit) in self.intervals.items()
            ),
        ]
