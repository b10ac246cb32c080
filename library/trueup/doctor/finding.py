"""Finding: one thing that is wrong with a log, with its evidence, and the mend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from trueup.canonical import Json
from trueup.doctor.mends import Mend


class Fault(StrEnum):
    """What may be wrong with a log."""

    POSITION_UNIT = "position_unit"
    VELOCITY_UNIT = "velocity_unit"
    LENGTH_UNIT = "length_unit"
    COMMAND_SIGN = "command_sign"
    COMMAND_SCALE = "command_scale"
    COMMAND_BEYOND_LIMITS = "command_beyond_limits"
    JOINTS_SWAPPED = "joints_swapped"
    TOPIC_OFFSET = "topic_offset"
    VELOCITY_LAG = "velocity_lag"
    VELOCITY_SIGN = "velocity_sign"
    GAP = "gap"
    STUCK = "stuck"
    REPEATED_SAMPLES = "repeated_samples"
    REPEATED_STAMPS = "repeated_stamps"
    MISSING_SAMPLES = "missing_samples"
    OUTLIERS = "outliers"
    CLIPPED_SENSOR = "clipped_sensor"
    CLOCK_OFF_STEP = "clock_off_step"
    OFFSET = "offset"


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a log.

    `episodes` are the digests of the recordings that have it; `from_s` and `to_s` [s] bound it in
    the first of them, None where it lasts from beginning to end. `confidence` lies between 0 and 1.
    `advice` says how the log is mended; `mends` do it, none where nothing but another recording
    helps. `applied` says whether it was done.
    """

    fault: Fault
    channel: str | None
    joint: str | None
    episodes: tuple[str, ...]
    confidence: float
    evidence: str
    advice: str
    mends: tuple[Mend, ...] = ()
    from_s: float | None = None
    to_s: float | None = None
    applied: bool = False

    def document(self) -> dict[str, Json]:
        """The finding as JSON."""
        return {
            "finding": str(self.fault),
            "channel": self.channel,
            "joint": self.joint,
            "episodes": list(self.episodes),
            "from_s": self.from_s,
            "to_s": self.to_s,
            "confidence": round(self.confidence, 3),
            "evidence": self.evidence,
            "mend": self.advice,
            "applied": self.applied,
        }


def documents(findings: Sequence[Finding]) -> list[Json]:
    """Findings as JSON."""
    return [f.document() for f in findings]


def files_of(finding: Finding, names: Mapping[str, str]) -> str:
    """The recordings of a finding by their names, `names` being those of digests."""
    return ", ".join(names.get(digest, digest[:12]) for digest in finding.episodes)
