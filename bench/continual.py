"""The cycle by itself: a machine whose friction grows to 1.8 times what it was between two builds,
with a real server and worker.

Nobody calls anything between the wear and the promotion. Beside it a planted update that has what
wore and has lost what only long travel shows, which must be rejected. `--picture FILE` keeps what
the monitors saw.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from pathlib import Path

from bench.report import Figure, show
from tests.support.fleet import WORN, Fleet
from tests.support.service import Service, command
from tests.support.storage import embedded
from trueup.episode.role import Role
from trueup_client import Client

REFERENCE, PROMISE_H = 40, 4.0


def main() -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        Service(embedded(Path(folder) / "data")).running() as service,
    ):
        client = Client(service.url, actor="fleet")
        figures = [*_cycle(client, Path(folder)), *_forgetting(client, Path(folder))]
        if "--picture" in sys.argv:
            command(
                service,
                "monitor",
                "wearing",
                "--picture",
                sys.argv[sys.argv.index("--picture") + 1],
            )
        client.close()
    show("Continual correction", figures)


def _cycle(client: Client, folder: Path) -> list[Figure]:
    fleet = Fleet(client, "wearing", folder, {"rule": "tracking_no_worse", "slack": 1.1})
    fleet.commission()
    fleet.watch(REFERENCE, PROMISE_H)
    fleet.automate(promise_h=PROMISE_H, reference_episodes=REFERENCE)
    for _ in range(5):
        fleet.visit(Role.ADAPTATION)
    fleet.until(lambda: client.monitor(fleet.name)["episodes"] == 10, "healthy episodes are seen")
    false_alarms = len(list(client.alarms(fleet.name)))
    fleet.friction *= WORN
    worn_at, recorded = time.monotonic(), fleet.recorded
    while client.serving(fleet.name).generation < 3 and fleet.recorded < recorded + 40:
        fleet.visit(Role.ADAPTATION, Role.VALIDATION)
    fleet.until(lambda: client.serving(fleet.name).generation == 3, "a correction is promoted")
    seconds, used = time.monotonic() - worn_at, fleet.recorded - recorded
    alarm = list(client.alarms(fleet.name))[-1]
    decision = client.decision(fleet.name, client.serving(fleet.name).decision)
    errors = decision["document"]["figures"]
    ratio = sum(errors["candidate"]["rollout"]) / sum(errors["incumbent"]["rollout"])
    driven = errors["closed_loop"]
    change, (low, high) = driven["change"], driven["change_ci95"] or (math.nan, math.nan)
    moved = next(
        e
        for e in client.audit(fleet.name)
        if e["kind"] == "pointer:moved" and e["facts"]["generation"] == 3
    )
    back_s = moved["facts"]["rehearsed"]["seconds"]
    while not client.monitor(fleet.name)["watches"] and fleet.recorded < recorded + 200:
        fleet.visit(Role.REFERENCE)
    for _ in range(5):
        fleet.visit(Role.ADAPTATION)
    fleet.until(lambda: client.monitor(fleet.name)["episodes"] >= 10, "healthy episodes are seen")
    after = client.monitor(fleet.name)
    return [
        Figure(
            "false alarms before the wear, 10 episodes", f"{false_alarms}", "0", false_alarms == 0
        ),
        Figure(
            "from the wear to a promoted correction, nobody calling",
            f"{used} episodes, {seconds:.0f} s",
            "promoted",
            True,
        ),
        Figure(
            "  what the alarm said",
            f"{next(iter(alarm['document']['detectors'].values()))['leading']}",
        ),
        Figure(
            "  held-out rollout error, corrected / before", f"{ratio:.2f}", "< 0.98", ratio < 0.98
        ),
        Figure(
            "  closed loop, tracking error, change by the correction",
            f"{change:+.3f} [{low:+.3f}, {high:+.3f}]",
            "< +0.10",
            change < 0.1,
        ),
        Figure("  going back, rehearsed before [s]", f"{back_s:.3f}", "<= 1", back_s <= 1.0),
        Figure(
            "  watched again, and silent",
            f"{after['watches'] and after['alarm'] is None}",
            "True",
            after["watches"] and after["alarm"] is None,
        ),
    ]


def _forgetting(client: Client, folder: Path) -> list[Figure]:
    fleet = Fleet(client, "forgetting", folder)
    fleet.commission()
    fleet.friction *= WORN
    fleet.visit(Role.VALIDATION, Role.VALIDATION)
    decision = fleet.judge(fleet.add_candidate(fleet.friction, cubic=0.0))
    said = next(
        v["because"] for v in decision["document"]["verdicts"] if v["rule"] == "retained_conditions"
    )
    return [
        Figure(
            "planted forgetting",
            f"{'accepted' if decision['accepted'] else 'rejected'}, {said}",
            "rejected",
            not decision["accepted"],
        )
    ]


if __name__ == "__main__":
    main()
