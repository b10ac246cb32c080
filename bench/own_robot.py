"""A simulator of one's own of two joints beside the same robot as MJCF: the verdicts, and the time.

MuJoCo is the machine, at a finer step than the models'. Both are diagnosed one after the other in
one process.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from bench.own_simulator import answer
from bench.report import Figure, show
from tests.support.own_arm import own_arm
from tests.support.robots import arm_plant, recorded
from trueup.diagnose.diagnosis import diagnose
from trueup.episode.role import Role

ROLES = [Role.ADAPTATION] * 3 + [Role.VALIDATION] * 2
WANTED = 20.0  # times as long at most


def _friction(spec: Any) -> None:
    spec.joint("elbow").frictionloss = 0.4
    spec.joint("shoulder").damping = [0.5, 0.0, 0.0]


def _damping(spec: Any) -> None:
    spec.joint("shoulder").damping = [0.6, 0.0, 0.0]


MACHINES: dict[str, Callable[[Any], None]] = {"friction": _friction, "damping": _damping}


def main() -> None:
    """Diagnose each machine with both."""
    rows, ratios, same = [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        plants = arm_plant(Path(folder)), own_arm()
        diagnose(plants[0], recorded(plants[0], _friction, range(5), ROLES, 1.0))  # compiles
        for name, change in MACHINES.items():
            said, at = [], [time.perf_counter()]
            for plant in plants:
                said.append(answer(diagnose(plant, recorded(plant, change, range(5), ROLES))))
                at.append(time.perf_counter())
            compiled, own = (b - a for a, b in pairwise(at))
            ratios.append(own / compiled)
            same += said[0] == said[1]
            rows.append(
                Figure(f"{name}: {said[0]}", f"{ratios[-1]:.1f} x", said[1], said[0] == said[1])
            )
            print(f"{name}: {said[0]} | {said[1]}, {compiled:.0f} s and {own:.0f} s", flush=True)
    total = len(ratios)
    rows.append(Figure("the same answer", f"{same} of {total}", "all", same == total))
    most = max(ratios)
    rows.append(Figure("time, own / MJCF, largest", f"{most:.1f}", f"{WANTED:.0f}", most <= WANTED))
    show("Own-robot", rows)
