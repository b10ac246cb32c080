"""Monitor: detectors on one predictor's residuals, calibrated to one promise in robot time, with
their measured performance.

The promise, one false alarm in so many operating hours, is of all joints and all detectors
together: each of them gets an equal share. The reference is split at random into halves within each
kind of episodes, because recordings come in patterns. One half sets the spread, and performance is
measured on the other; the levels that are used then come from both. The conformal test ranks
against the other half. Detectors that follow signatures need a longer reference: there are a
hundred signatures, and what is healthy for each must be known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json, digest_of
from trueup.episode.episode import Episode
from trueup.errors import BadMonitor, NotAnEpisode, NotIdentifiable
from trueup.model.predictor import Predictor
from trueup.monitor.achieved import achieved
from trueup.monitor.change import Before
from trueup.monitor.detector import CAUTION, Detector, Reference, State, detectors
from trueup.monitor.residuals import (
    Healthy,
    Residuals,
    UnscaledResiduals,
    blocks,
    unscaled_residuals,
)
from trueup.monitor.signature import Signatures

SCHEMA = "trueup.monitor/1"
LONGEST_BLOCK = 5  # rollouts
# episodes of each value of a condition, on the mean; one that is always another says nothing of
# kinds
COMES_AGAIN = 4
LEAST_BLOCKS = 8  # in either half of the reference
LEAST_FOR_SIGNATURES = 40  # blocks of the half that sets levels
LEAST_ERROR = 1e-9  # of a healthy spread, to take the logarithm of
# of the episodes may be shorter than a block, and then count for no more than single residuals
SHORT = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The result of one episode. For each detector the highest statistic, and, where it alarmed,
    the time [s] and the leading statistic; for each channel mean and root mean square, in healthy
    spreads."""

    seconds: float
    highest: Mapping[str, float]
    alarms: Mapping[str, tuple[float, str]]
    mean: Sequence[float]
    rms: Sequence[float]

    def document(self, channels: Sequence[str]) -> dict[str, Json]:
        """The result as JSON."""
        return {
            "seconds": self.seconds,
            "highest": dict(self.highest),
            "alarms": {
                d: {"at_s": at, "leading": leading} for d, (at, leading) in self.alarms.items()
            },
            "channels": {
                c: {"mean": m, "rms": r}
                for c, m, r in zip(channels, self.mean, self.rms, strict=True)
            },
        }


@dataclass(frozen=True, eq=False)
class Monitor:
    """What follows one predictor on one plant. It is frozen, and named by its digest.

    `figures` is the measured performance of the detectors, `reference` the digests of the healthy
    episodes, `before` their ranges and conditions; `usual` is mean and standard deviation of the
    logarithm of each channel's error over healthy episodes.
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
    usual: tuple[tuple[float, float], ...]
    figures: Mapping[str, Json]

    def begin(self) -> dict[str, State]:
        """The state of every detector before the first episode."""
        return {d.name: d.begin() for d in self.detectors}

    def follow(
        self, state: Mapping[str, Sequence[float]], predictor: Predictor, episode: Episode
    ) -> tuple[dict[str, State], Seen]:
        """Follow one more episode: the new state, and what was seen. Raises NotAnEpisode where it
        is too short for a rollout."""
        plant, of = predictor.plant, unscaled_residuals(predictor, episode)
        if not len(of.values):
            raise NotAnEpisode(
                f"no rollout of {plant.horizon_s:g} s can start in this episode",
                rule="samples",
                digest=episode.digest,
            )
        looked_for = (
            self.signatures if any(d.follows == "signatures" for d in self.detectors) else None
        )
        residuals = measured(predictor, self.healthy, looked_for, episode, of)
        channels, signs = [c.name for c in plant.layout.observations], self.signatures.names(plant)
        after: dict[str, State] = {}
        highest: dict[str, float] = {}
        alarms: dict[str, tuple[float, str]] = {}
        for detector in self.detectors:
            followed = detector.follow(tuple(state[detector.name]), residuals)
            after[detector.name] = followed.state
            highest[detector.name] = float(followed.statistic.max(initial=0.0))
            if followed.alarm is not None:
                leading = (
                    None
                    if followed.leading is None
                    else detector.labels(channels, signs)[followed.leading]
                )
                alarms[detector.name] = float(residuals.t_s[followed.alarm]), leading or ""
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
            "detectors": [
                {
                    "detector": d.name,
                    "rests_on": d.rests_on,
                    "guarantee": d.guarantee,
                    **d.document(),
                }
                for d in self.detectors
            ],
            "reference": list(self.reference),
            "before": self.before.document(),
            "usual": [list(u) for u in self.usual],
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
                tuple((float(mean), float(spread)) for mean, spread in document["usual"]),
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
    """A monitor of a predictor, the one that `artifact` names, whose detectors together give one
    false alarm in `promise_h` [h].

    `reference` are episodes in which the predictor was right; without `kinds` every detector takes
    part that it is long enough for. Raises BadMonitor, NotIdentifiable where the reference is too
    short.
    """
    if not (np.isfinite(promise_h) and promise_h > 0.0) or set(kinds) - set(detectors()):
        raise BadMonitor(
            "a monitor needs a positive promise in hours, and detectors that are known",
            detectors=", ".join(detectors()),
        )
    episodes = sorted(reference, key=lambda e: (e.start_ns, e.digest))
    misses: list[UnscaledResiduals] = []
    for episode in episodes:
        misses.append(unscaled_residuals(predictor, episode))
        progress("predicting healthy episodes", len(misses) / len(episodes))
    episodes, misses = (
        [e for e, m in zip(episodes, misses, strict=True) if len(m.values)],
        [m for m in misses if len(m.values)],
    )
    if len(misses) < 2:  # noqa: PLR2004  (halves)
        raise _too_short(len(misses), 0)
    rng = np.random.default_rng(seed)
    first, second = _halves(episodes, rng)
    healthy, signatures = (
        Healthy.of([misses[i] for i in first]),
        Signatures.of(predictor.plant, episodes),
    )
    residuals = [
        measured(predictor, healthy, signatures, e, m)
        for e, m in zip(episodes, misses, strict=True)
    ]
    lengths = sorted(r.windows for r in residuals)
    windows = max(1, min(LONGEST_BLOCK, lengths[int(SHORT * len(lengths))]))
    fitted, fresh = ([residuals[i] for i in half] for half in (first, second))
    parts = (
        [b for r in fitted for b in blocks(r, windows)],
        [b for r in fresh for b in blocks(r, windows)],
    )
    if min(len(p) for p in parts) < LEAST_BLOCKS:
        raise _too_short(len(episodes), sum(len(p) for p in parts))
    long = len(parts[0]) >= LEAST_FOR_SIGNATURES
    chosen = kinds or tuple(
        name for name, kind in detectors().items() if long or kind.follows == "channels"
    )
    share_h = promise_h * len(chosen)
    of = Reference(*parts, windows, float(np.mean([b.seconds for p in parts for b in p])), share_h)
    whole = replace(of, fitted=[*of.fitted, *of.fresh])
    made: list[Detector] = []
    for name in chosen:
        kind = detectors()[name]
        made.append(kind.calibrate(of if kind.reads_fresh else whole, rng))
        progress("setting levels", len(made) / len(chosen))
    by_detector: dict[str, Json] = {
        d.name: {**_judged(d, of, fresh, windows, share_h, rng)} for d in made
    }
    hours = sum(m.seconds for m in misses) / 3600.0
    figures: dict[str, Json] = {
        "reference_h": hours,
        "promise_shown": bool(hours / 2.0 > share_h / CAUTION),
        "block_s": of.block_s,
        "detectors": {**by_detector},
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
        _usual(residuals),
        figures,
    )


def _halves(
    episodes: Sequence[Episode], rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Two random halves of the episodes, each with as many of every kind. A kind is a combination
    of declared conditions that occurs more than once."""
    names = sorted({name for e in episodes for name in e.conditions})
    again = [
        n
        for n in names
        if len({e.conditions.get(n) for e in episodes}) <= len(episodes) / COMES_AGAIN
    ]
    kinds = [tuple(str(e.conditions.get(n)) for n in again) for e in episodes]
    order = sorted(rng.permutation(len(episodes)), key=lambda i: kinds[i])
    return np.sort(np.array(order[::2])), np.sort(np.array(order[1::2]))


def _judged(
    detector: Detector,
    of: Reference,
    fresh: Sequence[Residuals],
    windows: int,
    promise_h: float,
    rng: np.random.Generator,
) -> dict[str, Json]:
    """A detector's measured performance on the fresh half, when it is calibrated on the other half
    alone. One that reads the fresh half is calibrated on a part of it, and measured on the rest."""
    if not detector.reads_fresh:
        return achieved(detector.calibrate(of, rng), fresh, promise_h, rng)
    read, rest = fresh[::2], fresh[1::2]
    part = detector.calibrate(replace(of, fresh=[b for r in read for b in blocks(r, windows)]), rng)
    return achieved(part, rest or fresh, promise_h, rng)


def measured(
    predictor: Predictor,
    healthy: Healthy,
    signatures: Signatures | None,
    episode: Episode,
    of: UnscaledResiduals,
) -> Residuals:
    """The residuals of one episode as detectors follow them, with their evidence for `signatures`,
    if there are any."""
    residuals = healthy.residuals(of)
    return (
        residuals
        if signatures is None
        else signatures.evidence(predictor, episode, of, healthy, residuals)
    )


def _usual(residuals: Sequence[Residuals]) -> tuple[tuple[float, float], ...]:
    """Mean and standard deviation of the logarithm of each channel's error over episodes."""
    errors = np.log(np.maximum([r.mean_and_rms()[1] for r in residuals], LEAST_ERROR))
    return tuple(
        (float(m), float(s)) for m, s in zip(errors.mean(axis=0), errors.std(axis=0), strict=True)
    )


def _too_short(episodes: int, blocks: int) -> NotIdentifiable:
    """The error for a reference with too few episodes or blocks."""
    return NotIdentifiable(
        (
            f"{episodes} reference episodes with {blocks} blocks of rollouts are too few to know "
            "what is healthy"
        ),
        blocks=blocks,
        hint=(
            f"Record healthy operation with the role reference: {2 * LEAST_BLOCKS} blocks of "
            "rollouts at least, a hundred are better."
        ),
    )
