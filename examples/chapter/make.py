"""Write the recordings of this folder: the experiment's data, drawn from its seeds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from trueup.chapter.data import DATA_SEED, DRAWS, FAMILY, PLANT, draw
from trueup.episode.episode import Episode
from trueup.episode.writer import write_episode
from trueup.randomise.randomisation import SCHEMA, Randomisation
from trueup.randomise.training import training_episodes

HERE = Path(__file__).parent
EPOCH_NS = 1_716_000_000_000_000_000
APART_NS = 60_000_000_000  # from the start of one recording to that of the next


def write(folder: Path) -> None:
    """Write plant.json, the family and every recording into a folder."""
    (folder / "training").mkdir(parents=True, exist_ok=True)
    (folder / "plant.json").write_text(json.dumps(dict(PLANT.document), indent=1) + "\n")
    family = {"schema": SCHEMA, **FAMILY}
    (folder / "family.json").write_text(json.dumps(family, indent=1) + "\n")
    data, rng = draw(), np.random.default_rng(DATA_SEED)
    training = training_episodes(Randomisation.of(PLANT, FAMILY), DRAWS, rng)
    recordings: Mapping[str, Episode] = {
        **{f"training/plant-{i:02}": e for i, e in enumerate(training)},
        "adaptation": data.adaptation,
        "validation": data.validation,
        "mismatched": data.mismatched,
        "test": data.test,
    }
    for count, (name, episode) in enumerate(recordings.items()):
        with (folder / f"{name}.mcap").open("wb") as file:
            write_episode(
                file,
                stamps_ns=EPOCH_NS + count * APART_NS + np.rint(episode.t_s * 1e9).astype(np.int64),
                observations=episode.observations,
                commands=episode.commands,
                layout=episode.layout,
                role=episode.role,
                conditions={**episode.conditions, "machine": name.rpartition("/")[2]},
            )


if __name__ == "__main__":
    write(HERE)
