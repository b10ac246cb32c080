"""A sequential test whose false alarms are bounded by proof, whatever the noise: Shiryaev-Roberts
sums of conformal bets.

Each block's score is ranked among all healthy scores before it; while blocks are exchangeable the
ranks are independent and uniform, and a bet on high ranks is worth 1 on the mean. The sum of all
bets' products then reaches c in c blocks at the earliest, on the mean. Sources: V. Vovk, I.
Nouretdinov, A. Gammerman, ICML 2003, for conformal martingales; J. Shin, A. Ramdas, A. Rinaldo,
"E-detectors", New England Journal of Statistics in Data Science 2 (2024), for the sum and its mean
time between alarms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.monitor.detector import Detector, FollowedEpisode, Reference, State
from trueup.monitor.residuals import Residuals, blocks

Array = NDArray[np.float64]
MOST = 2000  # blocks that are learnt beside the reference's before it begins with those again
CERTAIN = 1.0 - 1e-4  # nearer to 1 the formula loses its digits; its limit is 1/2


@dataclass(frozen=True)
class ConformalTest(Detector):
    """An alarm when the sum of bets passes `level`, the number of blocks in the promised time;
    blocks have `windows` rollouts each. `scores` are those of the healthy blocks that the ranking
    begins with."""

    level: float
    windows: int
    scores: tuple[float, ...]
    name = "conformal_test"
    rests_on = (
        "proven if healthy blocks are exchangeable with those of the reference, whatever the "
        "dependence within a block"
    )
    guarantee = True
    reads_fresh = True

    @staticmethod
    def calibrate(reference: Reference, rng: np.random.Generator) -> ConformalTest:
        return ConformalTest(
            1.0 / reference.rate, reference.windows, tuple(_score(b) for b in reference.fresh)
        )

    def begin(self) -> State:
        return (0.0, *self.scores)

    def follow(self, state: State, residuals: Residuals) -> FollowedEpisode:
        gathered, known = state[0], np.array(state[1:])
        if len(known) > len(self.scores) + MOST:
            known = np.array(self.scores)
        statistic, alarm = np.full(len(residuals.values), gathered), None
        end = 0
        for block in blocks(residuals, self.windows):
            score = _score(block)
            rank = 1 + int((known >= score).sum())
            gathered = (gathered + 1.0) * bet(rank, len(known) + 1)
            known = np.append(known, score)
            end += len(block.values)
            statistic[end - 1 :] = gathered
            if gathered > self.level:
                alarm, gathered = end - 1 if alarm is None else alarm, 0.0
        return FollowedEpisode(
            statistic,
            alarm,
            None if alarm is None else int((residuals.weight @ residuals.values**2).argmax()),
            (gathered, *known.tolist()),
        )

    def labels(self, channels: Sequence[str], signs: Sequence[str]) -> list[str]:
        return [f"{c} is predicted worse" for c in channels]

    def exceedance(self, residuals: Residuals) -> float:
        parts, highest = blocks(residuals, self.windows), max(self.scores, default=np.inf)
        return float(np.mean([_score(b) > highest for b in parts])) if parts else 0.0

    def document(self) -> dict[str, Json]:
        return {"level": self.level, "windows": self.windows, "scores": list(self.scores)}

    @staticmethod
    def restore(document: Mapping[str, Any]) -> ConformalTest:
        return ConformalTest(
            float(document["level"]),
            int(document["windows"]),
            tuple(float(x) for x in document["scores"]),
        )


def bet(rank: int, count: int) -> float:
    """The value of a bet on a rank from the top, 1 to `count`: 1 on the mean over all ranks."""
    return float(_power(np.array([rank / count]))[0] / _mean(count))


@cache
def _mean(count: int) -> float:
    return float(_power(np.arange(1, count + 1) / count).mean())


def _power(p: Array) -> Array:
    """The mixture over all exponents of power bets, integral of e p^(e-1) over e from 0 to 1; at p
    = 1 it is 1/2."""
    p = np.minimum(p, CERTAIN)
    log = np.log(p)
    return np.asarray((1.0 - p + p * log) / (p * log**2))


def _score(block: Residuals) -> float:
    """The root mean square of the channel that has the largest."""
    share = block.weight / block.weight.sum()
    return float(np.sqrt((share @ block.values**2).max()))
