"""Make this case's recordings from the motions of the SAGE project: `python convert.py FOLDER`,
with a `MOTION.csv.gz` for each.

Their columns: time_s, then goal_JOINT_rad and pos_JOINT_rad of each joint, and others that are not
used.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant

HERE = Path(__file__).parent
CUTS = (
    ("chirp_sweep", 60.0, 85.0, Role.ADAPTATION),
    ("friction_gravity", 0.0, 25.0, Role.ADAPTATION),
    ("step_response", 0.0, 25.0, Role.ADAPTATION),
    (
        "workspace_sweep",
        0.0,
        15.0,
        Role.ADAPTATION,
    ),  # then pitch and elbow lean on something, and once more at 21.6 s
    ("prbs_excitation", 0.0, 20.0, Role.VALIDATION),
    ("backlash_detection", 0.0, 20.0, Role.VALIDATION),
)


def main(source: Path) -> None:
    """Cut, round and write every motion."""
    plant = Plant.from_document(resolved(json.loads((HERE / "plant.json").read_text()), HERE))
    for number, (motion, from_s, until_s, role) in enumerate(CUTS):
        table = np.genfromtxt(source / f"{motion}.csv.gz", delimiter=",", names=True)
        table = table[(table["time_s"] >= from_s) & (table["time_s"] <= until_s)]
        goals, positions = (
            np.stack([table[f"{what}_{j}_rad"] for j in plant.joints], axis=1)
            for what in ("goal", "pos")
        )
        with (HERE / f"{number}-{role}.mcap").open("wb") as stream:
            write_episode(
                stream,
                stamps_ns=np.rint(table["time_s"] * 1e9).astype(np.int64),
                observations=positions,
                commands=goals,
                layout=plant.layout,
                role=role,
                conditions={"stage": "physical", "motion": motion},
            )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
