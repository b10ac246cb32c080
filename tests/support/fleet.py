"""A robot that wears: two builds of one machine, recorded over short and long travel, and the calls
that its service gets."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.support.case import write_recording
from tests.support.made import T0_NS, corrected
from tests.support.simulated import episode_of
from trueup.artifact.artifact import pack
from trueup.episode.role import Role
from trueup.model.plant import Plant
from trueup.simulate.excitation import SHAPES, planned
from trueup.simulate.machine import Machine, run
from trueup_client import Client

STEP_S, SECONDS, SIGMA = 0.02, 12.0, (0.003, 0.005)
K, C, B, FRICTION, CUBIC = 2.0, 0.4, 1.0, 0.06, 2.5
WORN = 1.8  # ratio of the second build's friction to the first's
TRAVEL = {"short": 0.5, "long": 1.0}  # share of the command's limit
PATIENCE_S = 120.0
GATE = {
    "schema": "trueup.gate/1",
    "rules": [
        {"rule": "rollout_improves", "ratio": 0.98},
        {"rule": "retained_conditions", "slack": 1.1},
    ],
    "scoring": {"horizon_s": 2.0, "windows": "every"},
    "conditions": ["travel"],
    "held_out_uses": 20,
}


def plant_document(name: str) -> dict:
    """Returns the plant.json of the robot."""
    return {
        "name": name,
        "nominal": {
            "family": "oscillator",
            "parameters": {"k": K, "c": C, "b": B},
            "timestep_s": STEP_S,
        },
        "commands": [{"name": "u", "unit": "rad/s^2", "limits": [-1.0, 1.0]}],
        "observations": [{"name": "q", "unit": "rad"}, {"name": "v", "unit": "rad/s"}],
        "evaluation": {"horizon_s": 2.0},
    }


class Fleet:
    """One plant of a service, and the simulated machine that its episodes come from, with friction
    and, over long travel, a `cubic` stiffness."""

    def __init__(
        self, client: Client, name: str, folder: Path, *rules: dict, cubic: float = CUBIC
    ) -> None:
        self.client, self.name, self.folder, self.cubic = client, name, folder, cubic
        self._gate = {**GATE, "rules": [*GATE["rules"], *rules]}
        self.friction, self.recorded = FRICTION, 0
        self.plant = Plant.from_document(plant_document(name))

    def machine(self) -> Machine:
        """Returns the machine with its present friction."""
        rubs = Machine("oscillator", K, C, B, 1.0).having(
            "coulomb_friction", {"level": self.friction}
        )
        return rubs.having("cubic_stiffness", {"coefficient": self.cubic}) if self.cubic else rubs

    def record(self, role: Role, travel: str, size: float = 1.0) -> dict:
        """Records an episode of the machine, and uploads it."""
        self.recorded += 1
        rng = np.random.default_rng(self.recorded)
        shape = SHAPES[self.recorded % len(SHAPES)]
        series = size * TRAVEL[travel] * planned(shape, round(SECONDS / STEP_S) + 51, STEP_S, rng)
        recording = run(self.machine(), series, STEP_S, 20, SIGMA, rng, warm_up=50)
        path = self.folder / f"{self.name}-{self.recorded}.mcap"
        episode = episode_of(self.plant, recording, role, path.name)
        episode = replace(episode, conditions={"stage": "SIL", "travel": travel})
        write_recording(path, episode, T0_NS + self.recorded * 10**11)
        return self.client.upload_episode(self.name, path)

    def visit(self, *roles: Role) -> None:
        """Records an episode of each role over each travel."""
        for role in roles:
            for travel in TRAVEL:
                self.record(role, travel)

    def register(self) -> None:
        """Registers the plant, records the first build, and declares the gate."""
        self.client.register_plant(plant_document(self.name))
        self.visit(Role.ADAPTATION, Role.ADAPTATION, Role.VALIDATION)
        self.gate = self.client.declare_gate(self.name, self._gate)["digest"]

    def commission(self) -> None:
        """Registers the plant, diagnoses the first build, and promotes its model."""
        self.register()
        diagnosed = self.client.wait(self.client.submit(self.name, {"kind": "diagnose"})["id"])[
            "result"
        ]
        self.promote(diagnosed["artifact"])

    def judge(self, candidate: str) -> dict:
        """Returns the gate's decision on a candidate."""
        job = self.client.wait(
            self.client.submit(
                self.name, {"kind": "gate", "candidate": candidate, "gate": self.gate}
            )["id"]
        )
        return self.client.decision(self.name, job["result"]["decision"])

    def promote(self, candidate: str) -> None:
        """Judges a candidate, which must be accepted, and promotes it."""
        decision = self.judge(candidate)
        assert decision["accepted"], decision["document"]["verdicts"]
        self.client.promote(self.name, decision["digest"], decision["generation"])

    def watch(self, episodes: int, promise_h: float) -> None:
        """Records healthy operation, and calibrates a monitor on it."""
        for _ in range(episodes // 2):
            self.visit(Role.REFERENCE)
        self.client.wait(
            self.client.submit(self.name, {"kind": "calibrate", "promise_h": promise_h})["id"]
        )

    def automate(self, **choices: object) -> None:
        """Declares a policy under which every step happens without a person."""
        policy = {
            "schema": "trueup.policy/1",
            "gate": self.gate,
            "on_acceptance": "promote",
            **choices,
        }
        self.client.declare_policy(self.name, policy)

    def until(self, holds: object, what: str) -> None:
        """Waits until `holds()` is true. Fails with `what` after PATIENCE_S."""
        end = time.monotonic() + PATIENCE_S
        while not holds():  # type: ignore[operator]
            assert time.monotonic() < end, f"{what}: {self.client.monitor(self.name)}"
            time.sleep(0.1)

    def add_candidate(self, friction: float, cubic: float) -> str:
        """Adds a model with this friction and this stiffness of long travel. Returns its digest."""
        effects = {
            "coulomb_friction": {"level": friction},
            "cubic_stiffness": {"coefficient": cubic},
        }
        artifact = pack(corrected(self.plant, effects), {"origin": "by hand"})
        return str(
            self.client.add_artifact(self.name, artifact.manifest, artifact.arrays)["digest"]
        )
