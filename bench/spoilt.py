"""The doctor on logs that were spoilt on purpose, and on the same logs as they were.

Machines of the second simulator that no test has seen, every effect of the catalogue once and some
machines with none, on every tier; and the recordings in `examples/`. Each log is spoilt in every
way of `tests/support/spoilt.py` that it has the channels for. `CASES=FOLDER` adds the case folders
in a folder. `PUBLISH=1` keeps the table for the pages.
"""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from bench.report import Figure, publish, show
from tests.support.simulated import recorded
from tests.support.spoilt import ANGLES, EVERYWHERE, LENGTHS, TWO_JOINTS, WITH_VELOCITY, Spoil
from trueup.diagnose.case import read_case
from trueup.doctor.examine import examine
from trueup.doctor.finding import Fault
from trueup.episode.episode import Episode
from trueup.episode.layout import Field
from trueup.model.plant import Plant
from trueup.simulate.trial import CATALOGUE

EXAMPLES = Path(__file__).parent.parent / "examples"
TIERS = ("A0", "A1", "B1", "B2")
NONE = 8
SEED = 40400
NO_SPRING = "sensor_bias", "sensor_drift"  # nothing shows them on a bare inertia


def main() -> None:
    named: dict[str, list[bool]] = defaultdict(list)
    sound, seconds = [], []
    for name, plant, episodes in _logs():
        before = time.process_time()
        findings = [str(f.fault) for f in examine(plant, episodes)]
        seconds.append(time.process_time() - before)
        sound.append(not findings)
        if findings:
            print(f"{name}: {findings}", flush=True)
        for what, (fault, spoil) in _spoils(plant).items():
            named[what].append(fault in {f.fault for f in examine(plant, spoil(plant, episodes))})
    figures = [
        Figure(
            "sound logs without a finding",
            f"{sum(sound)} of {len(sound)}",
            "all",
            all(sound),
        ),
        Figure("CPU of a sound log, median [s]", f"{sorted(seconds)[len(seconds) // 2]:.2f}"),
    ]
    rows = [["nothing", "no finding", f"{sum(sound)} of {len(sound)}"]]
    for what, right in named.items():
        fault = {**EVERYWHERE, **ANGLES, **LENGTHS, **WITH_VELOCITY, **TWO_JOINTS}[what][0]
        share = f"{sum(right)} of {len(right)}"
        figures.append(Figure(what, share, "12 of 13", sum(right) >= 12 / 13 * len(right)))
        rows.append([what, f"`{fault}`", share])
    show("Spoilt logs: those that are named for what they are", figures)
    publish("spoilt", ["spoilt by", "named", "logs"], rows)


def _logs() -> Iterator[tuple[str, Plant, list[Episode]]]:
    effects = [*([name] for name in CATALOGUE), *([] for _ in range(NONE))]
    for i, names in enumerate(effects):
        tier = TIERS[i % len(TIERS)]
        if not (tier == "B2" and set(names) & set(NO_SPRING)):
            plant, episodes, _ = recorded(tier, names, SEED + i, runs=3)
            yield f"{tier} {names}", plant, episodes
    folders = [EXAMPLES / "emps"]
    if "CASES" in os.environ:
        folders += sorted(f for f in Path(os.environ["CASES"]).iterdir() if f.is_dir())
    for folder in folders:
        yield folder.name, *read_case(folder)


def _spoils(plant: Plant) -> dict[str, tuple[Fault, Spoil]]:
    """The ways in which a plant's log may be spoilt."""
    spoils = dict(EVERYWHERE)
    first = plant.layout.observations[0].unit
    spoils |= ANGLES if first.startswith("rad") else LENGTHS if first == "m" else {}
    if any(c.field is Field.VELOCITY for c in plant.layout.observations):
        spoils |= WITH_VELOCITY
        if not first.startswith("rad"):
            for what in ("positions in degrees", "velocity in rpm", "velocity in degrees"):
                spoils.pop(what)
    if len(plant.joints) == 2:
        spoils |= TWO_JOINTS
    return spoils
