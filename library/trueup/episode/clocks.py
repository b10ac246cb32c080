"""Check that the two clocks of a recording agree. Each message has a stamp of its sender, and a
time at which it was logged.

The difference is the latency. It is never much below 0, and it changes by little. A recording in
which the two clocks run at different speeds, in another order, or in which one stands still, has a
wrong clock; which one it is, only the owner can say.
"""

from __future__ import annotations

import numpy as np

from trueup.episode.track import Track

LATENCY_S = 1.0  # by so much a buffered logger may be late at one message and not at another
# of the recording: and clocks may drift apart by so much, far more than quartz does
LATENCY_SHARE = 0.05


def doubts(track: Track) -> tuple[str, ...]:
    """Contradictions between a topic's stamps and its log times, in words; none where it has no
    stamps, which are then not used."""
    if not track.has_stamps or len(track.stamp_ns) == 1:
        return ()
    stamps, logged = ((times - times[0]) / 1e9 for times in (track.stamp_ns, track.log_ns))
    span_s, back_s = float(stamps[-1]), float(np.max(np.maximum.accumulate(logged) - logged))
    apart_s = float(np.ptp(logged - stamps))
    if not logged.any():
        amiss = f"run for {span_s:.4g} s while the times at which they were logged stand still"
    elif back_s > LATENCY_S:
        amiss = f"run on while the times at which they were logged go back by {back_s:.4g} s"
    elif apart_s > max(LATENCY_S, LATENCY_SHARE * span_s):
        amiss = (
            f"and the times at which they were logged come apart by {apart_s:.4g} s in "
            f"{span_s:.4g} s, which is no latency"
        )
    else:
        return ()
    return (f"the stamps on {track.topic} {amiss}: one of the two clocks is wrong",)
