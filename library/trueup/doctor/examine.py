"""Examine: every examination of a log, in an order in which none is misled by what another one
finds.

Positions come first, then stamps; then velocities, which are held against positions alone; then the
units, signs, scales and order of whole joints. Each looks at the log as those before it mend it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.doctor.examinations import clocks, limits, samples, scales, velocity
from trueup.doctor.finding import Finding
from trueup.doctor.log import Log
from trueup.doctor.mends import CutAtGaps, Masked, gaps, without_masked
from trueup.episode.episode import Episode
from trueup.episode.layout import Field
from trueup.model.plant import Plant

EXAMINATIONS: tuple[Callable[[Log], list[Finding]], ...] = (
    samples.clipped,
    samples.stuck,
    samples.spikes_of_positions,
    clocks.examine,
    samples.repeated,
    velocity.examine,
    samples.spikes_of_velocities,
    scales.examine,
    limits.examine,
)


def examine(plant: Plant, episodes: Sequence[Episode]) -> list[Finding]:
    """What is wrong with the recordings of a plant, in the order in which it is mended. Empty where
    nothing is."""
    log, findings = Log(plant, episodes), list[Finding]()
    if not episodes:
        return findings
    for examination in EXAMINATIONS:
        more = examination(log)
        findings += more
        log = log.mended([m for f in more for m in f.mends if not isinstance(m, CutAtGaps)])
    return findings


@dataclass(frozen=True, slots=True)
class Usable:
    """What of some episodes says something about the machine, and what was found wrong with them.

    Masked samples are left out, and recordings are cut at gaps: nothing is put in the place of what
    is not known, and nothing is rolled through it. Units, signs and scales are as recorded: to
    change them somebody has to consent.
    """

    episodes: tuple[Episode, ...]
    findings: tuple[Finding, ...]


def usable(plant: Plant, episodes: Sequence[Episode]) -> Usable:
    """The usable part of the recordings of a plant."""
    findings = examine(plant, episodes)
    kept = list(episodes)
    for mend in (m for f in findings for m in f.mends if isinstance(m, Masked)):
        kept = mend.applied_to(kept)
    kept = [without_masked(e) for e in kept if not _is_all_masked(e)]
    cut = CutAtGaps(tuple(e.recording for e in kept), plant.horizon_s)
    pieces = [piece for e in kept for piece in (cut.apply(e) if len(gaps(e)) else [e])]
    return Usable(
        tuple(pieces),
        tuple(
            replace(f, applied=True)
            if f.mends and all(isinstance(m, Masked | CutAtGaps) for m in f.mends)
            else f
            for f in findings
        ),
    )


def _is_all_masked(episode: Episode) -> bool:
    """Whether nothing of an episode is left that says something."""
    seen = np.isfinite(episode.observations)
    positions = [c.field is Field.POSITION for c in episode.layout.observations]
    return not seen[:, positions].all(axis=1).any()
