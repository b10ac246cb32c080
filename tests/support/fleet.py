"""A robot that wears: two builds of one machine, recorded over short and long travel, and what its
fleet's service is told."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.support.made import T0_NS
from trueup.artifact.artifact import pack, unpack
from trueup.artifact.model import load
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.simulate.excitation import SHAPES, planned
from trueup.simulate.machine import Machine, run
from trueup_client import Client

STEP_S, SECONDS, SIGMA = 0.02, 12.0, (0.003, 0.005)
K, C, B, FRICTION, CUBIC = 2.0, 0.4, 1.0, 0.06, 2.5
WORN = 1.8  # times the friction of the build before
TRAVEL = {"short": 0.5, "long": 1.0}  # of the command's limit
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
    """One plant of a service, and the machine behind it. Episodes are recorded one after
    another."""

    def __init__(self, client: Client, name: str, folder: Path, *rules: dict) -> None:
        self.client, self.name, self.folder = client, name, folder
        self._gate = {**GATE, "rules": [*GATE["rules"], *rules]}
        self.friction, self.recorded = FRICTION, 0
        self.layout = Plant.from_document(plant_document(name)).layout

    def machine(self) -> Machine:
        made = Machine("oscillator", K, C, B, 1.0)
        return made.having("coulomb_friction", {"level": self.friction}).having(
            "cubic_stiffness", {"coefficient": CUBIC}
        )

    def record(self, role: Role, travel: str, size: float = 1.0) -> dict:
        """Run the machine, and upload what was recorded."""
        self.recorded += 1
        rng = np.random.default_rng(self.recorded)
        shape = SHAPES[self.recorded % len(SHAPES)]
        series = size * TRAVEL[travel] * planned(shape, round(SECONDS / STEP_S) + 51, STEP_S, rng)
        found = run(self.machine(), series, STEP_S, 20, SIGMA, rng, warm_up=50)
        path = self.folder / f"{self.name}-{self.recorded}.mcap"
        stamps = T0_NS + self.recorded * 10**11 + np.rint(found.t_s * 1e9).astype(np.int64)
        columns = {"observations": found.observed, "commands": found.issued[:, None]}
        with path.open("wb") as file:
            conditions = {"stage": "SIL", "travel": travel}
            write_episode(
                file,
                stamps_ns=stamps,
                layout=self.layout,
                role=role,
                conditions=conditions,
                **columns,
            )
        return self.client.upload_episode(self.name, path)

    def visit(self, *roles: Role) -> None:
        """An episode of each role over each travel."""
        for role in roles:
            for travel in TRAVEL:
                self.record(role, travel)

    def commission(self) -> None:
        """Register, diagnose the first build, and promote what passes."""
        self.client.register_plant(plant_document(self.name))
        self.visit(Role.ADAPTATION, Role.ADAPTATION, Role.VALIDATION)
        self.gate = self.client.declare_gate(self.name, self._gate)["digest"]
        diagnosed = self.client.wait(self.client.submit(self.name, {"kind": "diagnose"})["id"])[
            "result"
        ]
        self.promote(diagnosed["artifact"])

    def judge(self, candidate: str) -> dict:
        """What the gate decides of a candidate."""
        job = self.client.wait(
            self.client.submit(
                self.name, {"kind": "gate", "candidate": candidate, "gate": self.gate}
            )["id"]
        )
        return self.client.decision(self.name, job["result"]["decision"])

    def promote(self, candidate: str) -> None:
        decision = self.judge(candidate)
        assert decision["accepted"], decision["document"]["verdicts"]
        self.client.promote(self.name, decision["digest"], decision["generation"])

    def watch(self, episodes: int, promise_h: float) -> None:
        """Record healthy operation, and calibrate a monitor on it."""
        for _ in range(episodes // 2):
            self.visit(Role.REFERENCE)
        self.client.wait(
            self.client.submit(self.name, {"kind": "calibrate", "promise_h": promise_h})["id"]
        )

    def let_go(self, **choices: object) -> None:
        """Declare what may happen without a person: everything, if nothing else is said."""
        policy = {
            "schema": "trueup.policy/1",
            "gate": self.gate,
            "on_acceptance": "promote",
            **choices,
        }
        self.client.declare_policy(self.name, policy)

    def until(self, holds: object, what: str) -> None:
        """Wait for something that happens by itself."""
        end = time.monotonic() + PATIENCE_S
        while not holds():  # type: ignore[operator]
            assert time.monotonic() < end, f"{what}: {self.client.monitor(self.name)}"
            time.sleep(0.1)

    def forgetful(self) -> str:
        """A candidate that has what wore, and has lost what only long travel shows: added as a
        version, its digest."""
        serving = self.client.serving(self.name).artifact
        model = load(
            self.client.fetch(self.name, serving, self.folder / "served"), serving
        ).predictor
        assert isinstance(model, Corrected)
        values = list(model.values)
        rows = model.plant.block.rows_of("coulomb_friction")
        values[rows["level"]] *= WORN
        values[model.plant.block.rows_of("cubic_stiffness")["coefficient"]] = 0.0
        artifact = pack(replace(model, values=tuple(values)), {"origin": "by hand"})
        unpack(artifact)
        return str(
            self.client.add_artifact(self.name, artifact.manifest, artifact.arrays)["digest"]
        )
