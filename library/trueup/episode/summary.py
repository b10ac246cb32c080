"""A summary of an episode, to be read before it is opened."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.layout import Channel


def summarise(episode: Episode) -> dict[str, Json]:
    """Samples, duration [s], median period [s], gaps, conditions, missing channels, what it was
    made from if it came in another format, and the range of each channel in its unit."""
    channels = [
        *zip(episode.layout.observations, episode.observations.T, strict=True),
        *zip(episode.layout.commands, episode.commands.T, strict=True),
    ]
    return {
        "samples": len(episode.t_s),
        "duration_s": float(episode.t_s[-1]),
        "period_s": episode.period_s,
        "gaps": len(episode.gaps),
        "conditions": dict(episode.conditions),
        "missing": list(episode.missing),
        **({"source": dict(episode.source)} if episode.source else {}),
        "ranges": {channel.name: _range(channel, values) for channel, values in channels},
    }


def _range(channel: Channel, values: NDArray[np.float64]) -> Json:
    known = np.isfinite(values).all()
    return {
        "unit": channel.unit,
        "low": float(values.min()) if known else None,
        "high": float(values.max()) if known else None,
    }
