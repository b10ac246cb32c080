"""Monitor: detectors on one predictor's residuals, calibrated to one promise in robot time, with what they were measured to keep.

The promise, one false alarm in so many operating hours, is of all joints and all detectors together: each of them gets an equal
share. One half of the reference, drawn at random for recordings come in patterns, sets spread and levels; the other measures what
was set, and is what the conformal test ranks against. Detectors that follow signatures need a longer reference than others: there are a
hundred of them, and what is healthy for each must be known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from trueup.canonical import Json, digest_of
from trueup.episode.episode import Episode
from trueup.errors import BadMonitor, NotIdentifiable
from trueup.model.predictor import Predictor
from trueup.monitor.achieved import achieved
from trueup.monitor.change import Before
from trueup.monitor.detector import Detector, Reference, State, detectors
from trueup.monitor.residuals import Healthy, Missed, Residuals, blocks, missed
from trueup.monitor.signature import Signatures

SCHEMA = "trueup.monitor/1"
LONGEST_BLOCK = 5  # rollouts
LEAST_BLOCKS = 8  # in either half of the reference
LEAST_FOR_SIGNATURES = 40  # blocks of the half that sets levels
SHORT = 0.1  # of the episodes may be shorter than a block, and then count for no more than single residuals


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a monitor saw in one episode.

    Of each detector the highest statistic, and where it alarmed when [s] and what led; of each channel mean and root mean square, in
    healthy spreads.
    """

    seconds: float
    highest: Mapping[str, float]
    alarms: Mapping[str, tuple[float, str]]
    mean: Sequence[float]
    rms: Sequence[float]

    def document(self, channels: Sequence[str]) -> dict[str, Json]:
        """The same as JSON."""
        return {
            "seconds": self.seconds,
            "highest": dict(self.highest),
            "alarms": {d: {"at_s": at, "leading": leading} for d, (at, leading) in self.alarms.items()},
            "channels": {c: {"mean": m, "rms": r} for c, m, r in zip(channels, self.mean, self.rms, strict=True)},
        }


@dataclass(frozen=True, eq=False)
class Monitor:
    """What follows one predictor on one plant. Frozen, and named by its digest.

    `figures` is what the detectors were measured to keep, `reference` the digests of the healthy episodes, `before` what they were like.
    """

    plant: str
    artifact: str
    healthy: Healthy
    signatures: Signatures
    windows: int
    promise_h: float
    detectors: tuple[Detector, ...]
    reference: tuple[str, ...]
    before: Before
    figures: Mapping[str, Json]

    def begin(self) -> dict[str, State]:
        """What is known before the first episode."""
        return {d.name: d.begin() for d in self.detectors}

    def follow(self, state: Mapping[str, Sequence[float]], predictor: Predictor, episode: Episode) -> tuple[dict[str, State], Seen]:
        """One more episode: what is kept, and what was seen."""
        residuals = measured(predictor, self.healthy, self.signatures, episode, missed(predictor, episode))
        plant = predictor.plant
        channels, signs = [c.name for c in plant.layout.observations], self.signatures.names(plant)
        after: dict[str, State] = {}
        highest: dict[str, float] = {}
        alarms: dict[str, tuple[float, str]] = {}
        for detector in self.detectors:
            found = detector.follow(tuple(state[detector.name]), residuals)
            after[detector.name] = found.state
            highest[detector.name] = float(found.statistic.max(initial=0.0))
            if found.alarm is not None:
                leading = None if found.leading is None else detector.labels(channels, signs)[found.leading]
                alarms[detector.name] = float(residuals.t_s[found.alarm]), leading or ""
        mean, rms = residuals.mean_and_rms()
        return after, Seen(residuals.seconds, highest, alarms, mean, rms)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical document."""
        return digest_of(self.document())

    def document(self) -> dict[str, Json]:
        """The monitor as JSON."""
        return {
            "schema": SCHEMA,
            "plant": self.plant,
            "artifact": self.artifact,
            "healthy": self.healthy.document(),
            "signatures": self.signatures.document(),
            "windows": self.windows,
            "promise_h": self.promise_h,
            "detectors": [{"detector": d.name, "rests_on": d.rests_on, "guarantee": d.guarantee, **d.document()} for d in self.detectors],
            "reference": list(self.reference),
            "before": self.before.document(),
            "figures": dict(self.figures),
        }

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Monitor:
        """Read a monitor. Raises BadMonitor."""
        try:
            if document["schema"] != SCHEMA:
                raise ValueError(f"the schema is {document['schema']!r}, {SCHEMA!r} was expected")
            return Monitor(
                document["plant"],
                document["artifact"],
                Healthy.from_document(document["healthy"]),
                Signatures.from_document(document["signatures"]),
                int(document["windows"]),
                float(document["promise_h"]),
                tuple(detectors()[d["detector"]].restore(d) for d in document["detectors"]),
                tuple(document["reference"]),
                Before.from_document(document["before"]),
                document["figures"],
            )
        except (KeyError, TypeError, ValueError) as error:
            raise BadMonitor(f"the monitor cannot be read: {error!r}") from error


def calibrate(
    predictor: Predictor,
    artifact: str,
    reference: Sequence[Episode],
    promise_h: float,
    seed: int = 0,
    kinds: Sequence[str] = (),
    progress: Callable[[str, float], None] = lambda _stage, _part: None,
) -> Monitor:
    """A monitor of a predictor, the one that `artifact` names, whose detectors together give one false alarm in `promise_h` [h].

    `reference` are episodes in which the predictor was right; without `kinds` every detector takes part that it is long enough for.
    Raises BadMonitor, NotIdentifiable where the reference is too short.
    """
    if not (np.isfinite(promise_h) and promise_h > 0.0) or set(kinds) - set(detectors()):
        raise BadMonitor("a monitor needs a positive promise in hours, and detectors that are known", detectors=", ".join(detectors()))
    episodes = sorted(reference, key=lambda e: (e.start_ns, e.digest))
    found: list[Missed] = []
    for episode in episodes:
        found.append(missed(predictor, episode))
        progress("predicting healthy episodes", len(found) / len(episodes))
    if len(found) < 2:  # noqa: PLR2004  (halves)
        raise _too_short(len(found), 0)
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(found))
    first, second = np.sort(order[::2]), np.sort(order[1::2])
    healthy, signatures = Healthy.of([found[i] for i in first]), Signatures.of(predictor.plant, episodes)
    residuals = [measured(predictor, healthy, signatures, e, m) for e, m in zip(episodes, found, strict=True)]
    lengths = sorted(r.windows for r in residuals)
    windows = max(1, min(LONGEST_BLOCK, lengths[int(SHORT * len(lengths))]))
    fitted, fresh = ([residuals[i] for i in half] for half in (first, second))
    parts = [b for r in fitted for b in blocks(r, windows)], [b for r in fresh for b in blocks(r, windows)]
    if min(len(p) for p in parts) < LEAST_BLOCKS:
        raise _too_short(len(episodes), sum(len(p) for p in parts))
    long = len(parts[0]) >= LEAST_FOR_SIGNATURES
    chosen = kinds or tuple(name for name, kind in detectors().items() if long or kind.follows == "channels")
    share_h = promise_h * len(chosen)
    of = Reference(*parts, windows, float(np.mean([b.seconds for p in parts for b in p])), share_h)
    made: list[Detector] = []
    for name in chosen:
        made.append(detectors()[name].calibrate(of, rng))
        progress("setting levels", len(made) / len(chosen))
    unread = [d.calibrate(replace(of, fresh=()), rng) if d.reads_fresh else d for d in made]
    figures: dict[str, Json] = {d.name: {**achieved(d, u, fresh, share_h, rng)} for d, u in zip(made, unread, strict=True)}
    hours = sum(m.seconds for m in found) / 3600.0
    told: dict[str, Json] = {
        "reference_h": hours,
        "promise_shown": bool(hours > promise_h),
        "block_s": of.block_s,
        "detectors": {**figures},
    }
    return Monitor(
        predictor.plant.digest,
        artifact,
        healthy,
        signatures,
        windows,
        promise_h,
        tuple(made),
        tuple(e.digest for e in episodes),
        Before.of(episodes),
        told,
    )


def measured(predictor: Predictor, healthy: Healthy, signatures: Signatures, episode: Episode, of: Missed) -> Residuals:
    """What was missed in one episode as detectors take it."""
    return signatures.evidence(predictor, episode, of, healthy, healthy.residuals(of))


def _too_short(episodes: int, found: int) -> NotIdentifiable:
    return NotIdentifiable(
        f"{episodes} reference episodes with {found} blocks of rollouts are too few to know what is healthy",
        blocks=found,
        hint=f"Record healthy operation with the role reference: {2 * LEAST_BLOCKS} blocks of rollouts at least, a hundred are better.",
    )
