"""Side by side: two models on the same recordings: where the second is better than the first, and
where worse.

Errors are of rollouts that start at each multiple of the horizon, as everywhere; a map's value is
the second's absolute error less the first's, so that below nothing the second is better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.diagnose.figures import furthest
from trueup.diagnose.maps import Places, maps
from trueup.diagnose.traces import named, number, predicted, rms, traces
from trueup.episode.episode import Episode
from trueup.model.predictor import Predictor
from trueup.model.state import known_from, smoothed_states

Array = NDArray[np.float64]
SCHEMA = "trueup.side-by-side/1"
COMPARISON_FILE = "comparison.json"
FIRST, SECOND = "first", "second"


def side_by_side(
    first: Predictor, second: Predictor, episodes: Sequence[Episode]
) -> dict[str, Json]:
    """Two models of one plant on some episodes, as JSON, schema `trueup.side-by-side/1`."""
    plant, models = first.plant, {FIRST: first, SECOND: second}
    columns = list(enumerate(plant.layout.observations))
    missed = {name: [_missed(model, e) for e in episodes] for name, model in models.items()}
    places = [_places(first, e) for e in episodes]
    drawn: list[Json] = []
    for at, channel in columns:
        of = {name: np.concatenate([m[:, at] for m in errors]) for name, errors in missed.items()}
        joint = plant.joint_of(channel)
        where = Places(
            plant,
            joint,
            *(
                np.concatenate([p[axis][..., joint] if axis < 2 else p[axis] for p in places])  # noqa: PLR2004
                for axis in range(3)
            ),
        )
        worse = {"worse": np.abs(of[SECOND]) - np.abs(of[FIRST])}
        drawn.append(
            {
                **named(plant, channel),
                "rms": {name: number(rms(m)) for name, m in of.items()},
                **maps(worse, where),
            }
        )
    return {
        "schema": SCHEMA,
        "plant": plant.name,
        "horizon_s": plant.horizon_s,
        "episodes": traces(plant, furthest(episodes, plant.scales), models, columns),
        "maps": drawn,
        "by_episode": [
            _by_episode(e, {name: errors[i] for name, errors in missed.items()}, columns)
            for i, e in enumerate(episodes)
        ],
    }


def _missed(model: Predictor, episode: Episode) -> Array:
    """What a model misses of each sample from which the state is known, `(samples,
    observations)`."""
    begin = known_from(model.plant, episode)
    return np.asarray(predicted(model, episode)[begin:] - episode.observations[begin:])


def _places(of: Predictor, episode: Episode) -> tuple[Array, Array, Array]:
    """Speed and command `(samples, joints)` and time [s] `(samples,)` of the same samples."""
    begin, plant = known_from(of.plant, episode), of.plant
    states = smoothed_states(plant, episode)[begin:]
    return (
        states[:, len(plant.joints) :],
        plant.applied(episode.commands)[begin:],
        episode.t_s[begin:],
    )


def _by_episode(
    episode: Episode, missed: Mapping[str, Array], columns: Sequence[tuple[int, Any]]
) -> Json:
    return {
        "sha256": episode.digest,
        "role": str(episode.role),
        "channels": {
            c.name: {name: number(rms(m[:, at])) for name, m in missed.items()} for at, c in columns
        },
    }
