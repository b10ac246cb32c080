"""Change: what is different since the reference, once a monitor alarms.

The machine may have changed, or only its task. The report distinguishes channels that are predicted
worse, samples outside the range that the reference covers, another sampling period, and other
declared conditions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.summary import summarise

Array = NDArray[np.float64]
Range = tuple[float, float]
GROWN = float(np.log(1.05))  # of a channel's error: less is not the beginning of anything
BEYOND = 0.05  # of the reference's range: a little outside is not another task
PERIOD = 0.05  # relatively
SPAN = 1e-12  # of a range that is a point


@dataclass(frozen=True, slots=True)
class Before:
    """What healthy episodes were like: ranges of observations and commands in declared units,
    sampling period [s], declared conditions."""

    ranges: Mapping[str, Range]
    period_s: float
    conditions: Mapping[str, Sequence[str]]

    @staticmethod
    def of(episodes: Sequence[Episode]) -> Before:
        """The ranges, period and conditions of healthy episodes."""
        return Before.of_summaries([summarise(e) for e in episodes])

    @staticmethod
    def of_summaries(summaries: Sequence[Mapping[str, Any]]) -> Before:
        """The ranges, period and conditions of healthy episodes, from their summaries. A channel
        that was never observed is left out."""
        seen: dict[str, list[Range]] = {}
        declared: dict[str, set[str]] = {}
        for summary in summaries:
            for channel, of in summary["ranges"].items():
                if of["low"] is not None:
                    seen.setdefault(channel, []).append((of["low"], of["high"]))
            for name, value in summary["conditions"].items():
                declared.setdefault(name, set()).add(value)
        ranges = {
            c: (min(low for low, _ in r), max(high for _, high in r)) for c, r in seen.items()
        }
        periods = [float(s["period_s"]) for s in summaries]
        return Before(
            ranges,
            float(np.median(periods)),
            {name: sorted(values) for name, values in declared.items()},
        )

    def document(self) -> dict[str, Json]:
        """The ranges, period and conditions as JSON."""
        return {
            "ranges": {c: list(r) for c, r in self.ranges.items()},
            "period_s": self.period_s,
            "conditions": {name: list(values) for name, values in self.conditions.items()},
        }

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Before:
        """Read what `document` returned. Raises KeyError, TypeError, ValueError."""
        ranges = {c: (float(low), float(high)) for c, (low, high) in document["ranges"].items()}
        return Before(
            ranges,
            float(document["period_s"]),
            {n: tuple(v) for n, v in document["conditions"].items()},
        )


def onset(rms: Array, usual: Sequence[tuple[float, float]]) -> int:
    """The episode from which on errors grew, from the errors `(episodes, channels)` in healthy
    spreads up to an alarm. `usual` is mean and standard deviation of the logarithm of each
    channel's healthy error.

    For each channel, the logarithm of its error less its usual mean and a margin is summed, and the
    sum kept from falling below 0. The result is the episode after which the largest sum was last 0.
    Source: E. S. Page, Biometrika 41 (1954), on estimating the change.
    """
    mean, spread = np.array(usual).T
    above = np.log(np.maximum(rms, 1e-9)) - mean - np.maximum(spread, GROWN)
    gathered, since = np.zeros(rms.shape[1]), np.zeros(rms.shape[1], np.int64)
    for i, row in enumerate(above):
        gathered = np.maximum(gathered + row, 0.0)
        since[gathered == 0.0] = i + 1
    return min(int(since[gathered.argmax()]), len(rms) - 1)


def changed(reference: Before, channels: Mapping[str, Array], now: Before) -> dict[str, Json]:
    """What has changed since the reference: for each channel the errors of recent episodes in
    healthy spreads (`channels`), ranges, period, conditions. `words` says it for people."""
    errors: dict[str, Json] = {}
    words: list[str] = []
    for channel, rms in channels.items():
        size = float(np.sqrt(np.mean(rms**2)))
        errors[channel] = {"error": size, "episodes": [float(x) for x in rms]}
        if np.log(size) > GROWN:
            words.append(f"{channel} is predicted {size:.2g} times as badly as in the reference")
    outside: dict[str, Json] = {}
    for channel, (low, high) in now.ranges.items():
        known = reference.ranges.get(channel)
        if known is None:
            continue
        span = max(known[1] - known[0], SPAN)
        past = max(known[0] - low, high - known[1]) / span
        if past > BEYOND:
            outside[channel] = {"low": low, "high": high, "reference": list(known)}
            words.append(
                f"{channel} goes {100 * past:.0f} % of its range beyond what the reference covers"
            )
    others: dict[str, Json] = {}
    for name in sorted({*reference.conditions, *now.conditions}):
        before, after = list(reference.conditions.get(name, ())), list(now.conditions.get(name, ()))
        if name != "role" and set(after) - set(before):
            others[name] = {"reference": before, "now": after}
            words.append(
                f"{name} is {' and '.join(after)}, in the reference "
                f"{' and '.join(before) or 'not declared'}"
            )
    if abs(now.period_s / reference.period_s - 1.0) > PERIOD:
        words.append(
            f"samples come every {now.period_s:.4g} s, in the reference every "
            f"{reference.period_s:.4g} s"
        )
    return {
        "channels": errors,
        "outside": outside,
        "conditions": others,
        "period_s": now.period_s,
        "words": words,
    }
