"""Diagnosis of robots that nobody has seen: arms of two, three and six joints by lot, the truth in
MuJoCo at a sixteenth of the control period, one effect at one joint, two at two joints, a payload,
or nothing but other numbers.

The laws of the truth are written here and share no line with the catalogue's; what MuJoCo has
itself (friction loss) is MuJoCo's.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np

from bench.peers.environment import HERE, peers_python
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.measure import closed_on
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant

PERIOD_S, FINE, SECONDS, HORIZON_S = 0.004, 16, 5.0, 0.5
LEAD_S = 1.0  # before the log begins
ROLES = ("adaptation",) * 4 + ("validation",) * 2 + ("test",) * 2
NOISE = (2e-4, 3e-3)  # [rad, rad/s]
EFFECTS = (
    "coulomb_friction", "stribeck_friction", "quadratic_drag", "cubic_stiffness", "constant_force",
    "cogging", "hard_stop", "deadband",
    "backlash",
    "actuator_lag", "actuator_delay", "saturation", "rate_limit", "gain_asymmetry", "sensor_bias",
    "sensor_scale", "sensor_delay",
)  # fmt: skip
SINGLES, PAIRS, PAYLOADS, LARGE = 12, 4, 4, 2
PEERS = 4  # machines of the first that mujoco.sysid is given too: it takes minutes for each
MODELS, WINDOWS = 16, 20
SIX = 6
AXES = {2: "yy", 3: "zyy", SIX: "zyyxyx"}
LIMITS = (40.0, 25.0, 12.0, 6.0, 4.0, 2.0)  # [N m]
# of the controller
STIFF, DAMP = (45.0, 25.0, 10.0, 6.0, 4.0, 2.0), (4.5, 2.5, 1.0, 0.5, 0.3, 0.15)
SEED = 7


class Arm:
    """A machine: a nominal model as MJCF, and what its truth does otherwise."""

    def __init__(
        self, rng: np.random.Generator, hidden: dict[int, str], payload: bool, joints: int = 0
    ) -> None:
        self.n = joints or int(rng.integers(2, 4))
        self.hidden, self.payload, self.rng = hidden, payload, rng
        lengths, masses = (
            rng.uniform(0.2, 0.4, self.n),
            np.sort(rng.uniform(0.6, 2.2, self.n))[::-1],
        )
        damping, armature = rng.uniform(0.1, 0.4, self.n), rng.uniform(0.01, 0.04, self.n)
        # a wrist's forces are small
        self.size = np.minimum(np.array(LIMITS[: self.n]) / LIMITS[2], 1.0)
        if self.n == SIX:
            lengths, masses, damping, armature = (
                lengths * 0.5 ** (np.arange(SIX) / 2),
                masses * self.size,
                damping * self.size,
                armature * self.size,
            )
        body, ends = "", ""
        for j in range(self.n):
            place = lengths[j - 1] if j else 0.0
            body += (
                f'<body name="l{j}" pos="{place:g} 0 0"><joint name="j{j}" '
                f'axis="{_axis(AXES[self.n][j])}" damping="{damping[j]:g}" '
                f'armature="{armature[j]:g}"/><geom type="capsule" fromto="0 0 0 '
                f'{lengths[j]:g} 0 0" size="0.03" mass="{masses[j]:g}" '
                'contype="0" conaffinity="0"/>'
            )
            ends += "</body>"
        motors = "".join(f'<motor joint="j{j}"/>' for j in range(self.n))
        option = f'<option timestep="{PERIOD_S}" integrator="implicitfast"/>'
        self.xml = (
            "<mujoco "
            f'model="arm">{option}<worldbody>{body}{ends}</worldbody><actuator>{motors}</actuator></mujoco>'
        )
        self.limits = np.array(LIMITS[: self.n])
        self.tip = lengths[-1]
        self.strength = rng.uniform(0.7, 1.4, self.n)

    def plant(self) -> Plant:
        """The plant as its people declare it."""
        names = [f"j{j}" for j in range(self.n)]
        document = {
            "name": "arm",
            "nominal": {"mjcf": "arm.xml", "timestep_s": PERIOD_S},
            "commands": [
                {"name": f"tau_{x}", "joint": x, "unit": "N·m", "limits": [-float(m), float(m)]}
                for x, m in zip(names, self.limits, strict=True)
            ],
            "observations": [
                {"name": f"{s}_{x}", "joint": x, "field": f, "unit": u}
                for s, f, u in (("q", "position", "rad"), ("v", "velocity", "rad/s"))
                for x in names
            ],
            "evaluation": {"horizon_s": HORIZON_S},
        }
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "arm.xml").write_text(self.xml)
            return Plant.from_document(resolved(document, Path(folder)))

    def truth(self) -> mujoco.MjModel:
        """The machine itself: other masses and dampings, a payload, friction loss."""
        spec = mujoco.MjSpec.from_string(self.xml)
        spec.option.timestep = PERIOD_S / FINE
        for j in range(self.n):
            spec.joint(f"j{j}").damping = np.asarray(
                spec.joint(f"j{j}").damping
            ) * self.rng.uniform(0.85, 1.2)
            spec.body(f"l{j}").first_geom().mass *= self.rng.uniform(0.9, 1.1)
            if self.hidden.get(j) == "coulomb_friction":
                spec.joint(f"j{j}").frictionloss = 0.35 * self.strength[j] * self.size[j]
        if self.payload:
            spec.body(f"l{self.n - 1}").add_geom(
                type=2, size=[0.03, 0, 0], pos=[self.tip, 0, 0], mass=self.rng.uniform(0.3, 0.8)
            )
        return spec.compile()

    def recorded(self, plant: Plant) -> list[Episode]:
        """Episodes under a controller that follows slow waves, seen through noise."""
        model = self.truth()
        return [self._episode(plant, model, role, i) for i, role in enumerate(ROLES)]

    def _episode(self, plant: Plant, model: mujoco.MjModel, role: str, number: int) -> Episode:
        rng, data, n = self.rng, mujoco.MjData(model), self.n
        lead = round(LEAD_S / PERIOD_S)
        samples = lead + round(SECONDS / PERIOD_S) + 1
        t = np.arange(samples) * PERIOD_S
        data.qpos[:] = rng.uniform(-0.5, 0.5, n)
        waves = np.stack(
            [
                sum(
                    a * np.sin(2 * np.pi * f * t + p)
                    for a, f, p in rng.uniform((0.1, 0.2, 0.0), (0.5, 1.5, 6.3), (3, 3))
                )
                for _ in range(n)
            ]
        )
        drives = [
            _drive(self.hidden.get(j, ""), self.strength[j], self.limits[j]) for j in range(n)
        ]
        forces = [_force(self.hidden.get(j, ""), self.strength[j], self.size[j]) for j in range(n)]
        seen, issued, past = np.empty((samples, 2 * n)), np.empty((samples, n)), []
        stiff, damp = np.array(STIFF[:n]), np.array(DAMP[:n])
        for i in range(samples):
            past.append(np.concatenate([data.qpos, data.qvel]))
            shown = self._shown(past, i)
            seen[i] = shown + rng.normal(size=2 * n) * np.repeat(NOISE, n)
            issued[i] = np.clip(
                stiff * (waves[:, i] - seen[i, :n]) - damp * seen[i, n:], -self.limits, self.limits
            )
            for _ in range(FINE):
                data.ctrl[:] = [
                    drive(u, PERIOD_S / FINE) for drive, u in zip(drives, issued[i], strict=True)
                ]
                data.qfrc_applied[:] = [
                    force(q, v) for force, q, v in zip(forces, data.qpos, data.qvel, strict=True)
                ]
                mujoco.mj_step(model, data)
        t, issued, seen = t[:-lead], issued[lead:].copy(), seen[lead:].copy()
        return Episode(
            t,
            issued,
            seen,
            plant.layout,
            Role(role),
            {"stage": "SIL", "loop": "closed"},
            0,
            f"{role}-{number}",
        )

    def _shown(self, past: list[np.ndarray], i: int) -> np.ndarray:
        shown = past[i].copy()
        for j, effect in self.hidden.items():
            if effect == "sensor_bias":
                shown[j] += 0.06 * self.strength[j]
            if effect == "sensor_scale":
                shown[j] *= 1.0 + 0.08 * self.strength[j]
            if effect == "sensor_delay":
                late = past[max(0, i - round(2.0 * self.strength[j]) - 1)]
                shown[[j, self.n + j]] = late[[j, self.n + j]]
        return shown


def _axis(letter: str) -> str:
    return " ".join(str(int(letter == x)) for x in "xyz")


def _force(effect: str, strength: float, size: float) -> Callable[[float, float], float]:
    """A force at the joint by its position and velocity."""
    laws: dict[str, Callable[[float, float], float]] = {
        "quadratic_drag": lambda _q, v: -0.25 * strength * v * abs(v),
        "cubic_stiffness": lambda q, _v: -3.0 * strength * q**3,
        "constant_force": lambda _q, _v: 0.7 * strength,
        "cogging": lambda q, _v: 0.5 * strength * np.sin(2.0 * np.pi * q / 0.35 + 0.4),
        "hard_stop": lambda q, v: (
            -(400.0 * (q - 0.45) + 4.0 * v) * (q > 0.45)
            - (400.0 * (q + 0.45) + 4.0 * v) * (q < -0.45)
        ),
        "stribeck_friction": lambda _q, v: (
            -strength * np.tanh(v / 5e-3) * (0.15 + 0.35 * np.exp(-((v / 0.15) ** 2)))
        ),
    }
    law = laws.get(effect, lambda _q, _v: 0.0)
    return lambda q, v: size * law(q, v)


def _drive(effect: str, strength: float, limit: float) -> Callable[[float, float], float]:
    """What arrives of a command, called again and again with the step [s]."""
    memory = {"play": 0.0, "lag": 0.0, "rate": 0.0}
    waiting: list[float] = []

    def play(u: float, _h: float) -> float:
        half = 0.02 * limit * strength
        memory["play"] = min(max(memory["play"], u - half), u + half)
        return memory["play"]

    def lag(u: float, h: float) -> float:
        memory["lag"] += (u - memory["lag"]) * (1.0 - np.exp(-h / (0.025 * strength)))
        return memory["lag"]

    def rate(u: float, h: float) -> float:
        most = 3.0 * limit * strength * h
        memory["rate"] += min(max(u - memory["rate"], -most), most)
        return memory["rate"]

    def late(u: float, h: float) -> float:
        waiting.append(u)
        return waiting.pop(0) if len(waiting) > round(0.015 * strength / h) else waiting[0]

    laws: dict[str, Callable[[float, float], float]] = {
        "deadband": lambda u, _h: float(np.sign(u) * max(abs(u) - 0.03 * limit * strength, 0.0)),
        "saturation": lambda u, _h: min(max(u, -0.13 * limit * strength), 0.13 * limit * strength),
        "gain_asymmetry": lambda u, _h: u * (1.0 + 0.12 * strength * (u > 0.0)),
        "backlash": play,
        "actuator_lag": lag,
        "rate_limit": rate,
        "actuator_delay": late,
    }
    return laws.get(effect, lambda u, _h: u)


def trials(
    rng: np.random.Generator, singles: int, pairs: int, payloads: int, large: int = 0
) -> list[Arm]:
    """Machines by lot; the last of six joints."""
    made = []
    for i in range(singles + pairs + payloads + large):
        count = (
            2
            if singles <= i < singles + pairs
            else 0
            if singles + pairs <= i < singles + pairs + payloads
            else 1
        )
        arm = Arm(rng, {}, payload=count == 0, joints=SIX if i >= singles + pairs + payloads else 0)
        joints = rng.choice(arm.n, count, replace=False)
        arm.hidden = {int(j): str(rng.choice(EFFECTS)) for j in joints}
        made.append(arm)
    return made


def _write(folder: Path, arm: Arm, episodes: list[Episode]) -> None:
    """A machine as a peer gets it."""
    folder.mkdir(parents=True)
    (folder / "arm.xml").write_text(arm.xml)
    arrays: dict[str, np.ndarray] = {"horizon": np.array(round(HORIZON_S / PERIOD_S))}
    for role in ("adaptation", "test"):
        group = [e for e in episodes if e.role == role]
        arrays[role] = np.array(len(group))
        for i, e in enumerate(group):
            arrays |= {
                f"{role}{i}t": e.t_s,
                f"{role}{i}u": e.commands,
                f"{role}{i}y": e.observations,
            }
    np.savez(folder / "recordings.npz", **arrays)


def peers(cases: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Answers of mujoco.sysid without friction losses among its parameters and with them, by method
    and machine."""
    python = peers_python()
    answers = {}
    for method, more in (
        ("mujoco.sysid", []),
        ("mujoco.sysid, friction losses free", ["frictionloss"]),
    ):
        with tempfile.TemporaryDirectory() as out:
            subprocess.run(
                [python, "-m", "bench.peers.sysid", cases, out, *more],
                check=True,
                stdout=subprocess.DEVNULL,
                cwd=HERE.parent,
            )
            answers[method] = {
                file.stem: json.loads(file.read_text()) for file in Path(out).iterdir()
            }
    return answers


def speed(arm: Arm) -> float:
    """How many times as long mujoco.rollout takes, one thread each, for 16 neighbouring models of a
    robot on the same windows."""
    plant, model = arm.plant(), mujoco.MjModel.from_xml_string(arm.xml)
    rng, steps = np.random.default_rng(SEED), round(HORIZON_S / PERIOD_S)
    initial = rng.uniform(-0.3, 0.3, (WINDOWS, 2 * arm.n))
    applied = rng.uniform(-0.2, 0.2, (WINDOWS, steps + 1, arm.n)) * arm.limits
    parameters = np.repeat(np.array([plant.parameters]), MODELS, axis=0)
    parameters *= rng.uniform(0.999, 1.001, parameters.shape)
    h, once = np.full((WINDOWS, steps + 1), PERIOD_S), np.ones((WINDOWS, steps + 1), np.int64)
    states = np.concatenate(
        [np.zeros((WINDOWS * MODELS, 1)), np.tile(initial, (MODELS, 1))], axis=1
    )
    control = np.tile(applied[:, :steps], (MODELS, 1, 1))
    models, data = [model] * len(states), [mujoco.MjData(model)]

    def ours() -> None:
        plant.dynamics.rollout(parameters, initial, applied, h, once)

    def theirs() -> None:
        mujoco.rollout.rollout(models, data, states, control)

    def quickest(run: Callable[[], None]) -> float:
        run()
        times = []
        for _ in range(5):
            began = time.perf_counter()
            run()
            times.append(time.perf_counter() - began)
        return min(times)

    return quickest(theirs) / quickest(ours)


def told(answers: dict[str, dict[str, Any]], hidden: dict[str, dict[int, str]]) -> str:
    """What a peer's answers came to."""
    joint = sum({a["blamed"][1]} == {f"j{j}" for j in hidden[name]} for name, a in answers.items())
    friction = [name for name, of in hidden.items() if set(of.values()) == {"coulomb_friction"}]
    rubs = sum(answers[name]["blamed"][0] == "frictionloss" for name in friction)
    wrongly = sum(
        a["blamed"][0] == "frictionloss" for name, a in answers.items() if name not in friction
    )
    closed = np.median([1.0 - a["after"] / a["before"] for a in answers.values()])
    slowest = max(a["seconds"] for a in answers.values())
    return (
        f"joint of what it blames right {joint}/{len(answers)}, friction blamed "
        f"{rubs}/{len(friction)} where it is and "
        f"{wrongly}/{len(answers) - len(friction)} where it is not, closed {closed:.4f}, "
        f"{slowest:.0f} s at most"
    )


def main(arguments: list[str] | None = None) -> None:
    """Diagnose every machine and say how often effect and joint were right."""
    counts = [int(x) for x in arguments or []] or [SINGLES, PAIRS, PAYLOADS, LARGE]
    rng, rows = np.random.default_rng(SEED), []
    cases, hidden = Path(tempfile.mkdtemp()), {}
    for number, arm in enumerate(trials(rng, *counts)):
        plant = arm.plant()
        episodes = arm.recorded(plant)
        if number < PEERS:
            _write(cases / f"{number:03d}", arm, episodes)
            hidden[f"{number:03d}"] = arm.hidden
        began = time.perf_counter()
        found = diagnose(plant, [e for e in episodes if e.role is not Role.TEST])
        seconds = time.perf_counter() - began
        closed = closed_on(
            found.predictor, [e for e in episodes if e.role is Role.TEST], np.repeat(NOISE, arm.n)
        )
        named = {(str(e["effect"]), str(e.get("joint"))) for e in found.document["effects"]}  # type: ignore[union-attr,index,call-overload]
        others = [
            {(a["effect"], a["joint"]) for a in rival}
            for rival in found.document["indistinguishable"]
        ]  # type: ignore[union-attr,index,call-overload]
        wanted = {(e, f"j{j}") for j, e in arm.hidden.items()}
        kind = "six joints" if arm.n == SIX else ("payload", "single", "pair")[len(wanted)]
        right = named == wanted and (
            kind != "payload" or found.document["verdict"] == "parameters_only"
        )
        rows.append(
            (
                kind,
                right,
                right or wanted in others,
                {j for _, j in named} == {j for _, j in wanted},
                closed or 0.0,
                seconds,
            )
        )
        said = " + ".join(f"{e} at {j}" for e, j in sorted(named)) or str(found.document["verdict"])
        truth = " + ".join(f"{e} at {j}" for e, j in sorted(wanted)) or "payload"
        print(
            (
                f"{'' if right else 'MISS '}{arm.n} joints, {truth}: {said}; {len(others)} more, "
                f"closed {closed}, {seconds:.0f} s"
            ),
            file=sys.stderr,
        )
    for kind in ("single", "pair", "payload", "six joints"):
        of = [r for r in rows if r[0] == kind]
        if of:
            named, in_set, joint = (f"{sum(r[i] for r in of)}/{len(of)}" for i in (1, 2, 3))
            closed, slowest = np.median([r[4] for r in of]), max(r[5] for r in of)
            print(
                f"{kind}: named {named}, in the set {in_set}, joint {joint}, closed "
                f"{closed:.4f}, {slowest:.0f} s at most"
            )

    for joints in (3, SIX):
        arm = Arm(np.random.default_rng(SEED), {}, payload=False, joints=joints)
        print(
            f"{joints} joints: mujoco.rollout takes {speed(arm):.1f} times as long for "
            f"{MODELS} models in {WINDOWS} windows, a core each"
        )

    first = rows[: len(hidden)]
    right, closed, slowest = (
        sum(r[1] for r in first),
        np.median([r[4] for r in first]),
        max(r[5] for r in first),
    )
    print(
        f"the first {len(first)} machines: trueup names {right}, closed {closed:.4f}, "
        f"{slowest:.0f} s at most"
    )
    for method, answers in peers(cases).items():
        print(f"{method}: {told(answers, hidden)}")
    shutil.rmtree(cases)


if __name__ == "__main__":
    main(sys.argv[1:])
