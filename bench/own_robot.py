"""A simulator of one's own of two joints beside the same robot as MJCF: the verdicts, and the time.

MuJoCo is the machine, at a finer step than the models'. Both are diagnosed one after the other in
one process.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.own_simulator import Compared, Timed, show_compared
from tests.support.own_arm import own_arm
from tests.support.robots import arm_plant, recorded
from trueup.diagnose.diagnosis import diagnose
from trueup.episode.role import Role

ROLES = [Role.ADAPTATION] * 3 + [Role.VALIDATION] * 2


def _friction(spec: Any) -> None:
    spec.joint("elbow").frictionloss = 0.4
    spec.joint("shoulder").damping = [0.5, 0.0, 0.0]


def _damping(spec: Any) -> None:
    spec.joint("shoulder").damping = [0.6, 0.0, 0.0]


MACHINES: dict[str, Callable[[Any], None]] = {"friction": _friction, "damping": _damping}


def main() -> None:
    """Diagnose each machine with both."""
    with tempfile.TemporaryDirectory() as folder:
        plants = arm_plant(Path(folder)), own_arm()
        diagnose(plants[0], recorded(plants[0], _friction, range(5), ROLES, 1.0))  # compiles
        machines = []
        for name, change in MACHINES.items():
            by_mjcf, own = (Timed.of(p, recorded(p, change, range(5), ROLES)) for p in plants)
            machines.append(Compared(name, by_mjcf, own).told())
    show_compared("Own-robot", machines)
