"""Robots for tests, as MJCF and URDF, and recordings of them by MuJoCo at a finer step than the
plant's."""

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.model.mjcf import compile_file, tree_of
from trueup.model.mjcf import mujoco as engine
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.simulate.robot import RobotMachine

PERIOD_S, FINE = 0.004, 8

ARM = """<mujoco model="arm">
<option timestep="0.004" gravity="0 0 -9.81" integrator="implicitfast"/>
<worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1.6" contype="0" conaffinity="0"/>
<body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" damping="0.2" armature="0.03"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.9" contype="0" conaffinity="0"/>
</body></body></worldbody>
<actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>"""

EVERYTHING = """<mujoco><option timestep="0.002" integrator="implicitfast" gravity="0.3 -1 -9.81"/>
<worldbody>
<body pos="0.1 0.2 0.3" euler="10 20 30">
<joint name="a" axis="0.2 1 0.3" pos="0.05 0 0.1" damping="0.3" armature="0.01" ref="0.3"/>
<geom type="capsule" fromto="0 0 0 .3 0.1 0" size=".03" mass="2"/>
<body pos=".3 .1 0" euler="5 6 7">
<joint name="s" type="slide" axis="1 0.5 0" stiffness="30" springref="0.1" damping="2"/>
<geom type="box" size=".1 .05 .03" mass="1.5" pos=".1 0 0" euler="20 0 0"/>
<body pos="0 0 .1"><geom type="sphere" size=".05" mass=".4" pos=".02 .1 0"/></body>
<body pos=".2 0 0"><joint name="b" axis="0 0 1" damping=".1" armature=".02"/>
<joint name="c" axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 .2 .2" size=".02" mass=".8"/></body>
<body pos="-.2 0 0"><joint name="d" axis="1 0 1" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 .2 -.2" size=".02" mass=".6"/></body>
</body></body></worldbody>
<actuator><motor joint="a" gear="2"/><position joint="b" kp="12" kv=".5"/>
<motor joint="c" forcelimited="true" forcerange="-0.5 0.5"/></actuator></mujoco>"""

URDF = """<robot name="two"><link name="base"/>
<link name="one"><inertial><origin xyz="0.1 0 0"/><mass value="1.2"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="two"><inertial><origin xyz="0.1 0 0"/><mass value="0.7"/>
<inertia ixx="0.01" iyy="0.015" izz="0.015" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="first" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="10" velocity="5"/><dynamics damping="0.1"/></joint>
<joint name="second" type="continuous"><parent link="one"/><child link="two"/>
<origin xyz="0.2 0 0"/>
<axis xyz="0 1 0"/></joint></robot>"""


def arm_machine():
    """Returns ARM in the second simulator, without any fault."""
    tree = tree_of(engine(), mujoco.MjModel.from_xml_string(ARM))
    return RobotMachine(tree, np.full(2, -25.0), np.full(2, 25.0), np.full(2, 15.0))


def arm_document(**more):
    """Returns the plant.json of ARM."""
    joints = ("shoulder", "elbow")
    return {
        "name": "arm",
        "nominal": {"mjcf": "arm.xml", "timestep_s": PERIOD_S},
        "commands": [
            {"name": f"tau_{j}", "joint": j, "unit": "N·m", "limits": [-25.0, 25.0]} for j in joints
        ],
        "observations": [
            *({"name": f"q_{j}", "joint": j, "field": "position", "unit": "rad"} for j in joints),
            *({"name": f"v_{j}", "joint": j, "field": "velocity", "unit": "rad/s"} for j in joints),
        ],
        "evaluation": {"horizon_s": 0.5},
        **more,
    }


def arm_plant(folder, **more):
    """Writes the case folder of ARM, and returns its plant."""
    (folder / "arm.xml").write_text(ARM)
    (folder / "plant.json").write_text(json.dumps(arm_document(**more)))
    return Plant.from_document(resolved(arm_document(**more), folder))


def plant_of(folder, text, driven, name="robot.xml", period_s=0.002):
    """Writes a robot's file, and returns its plant, every joint of which is observed."""
    (folder / name).write_text(text)
    joints = compile_file(folder / name).tree.joints
    fields = (("q", "position", "rad"), ("v", "velocity", "rad/s"))
    document = {
        "name": "robot",
        "nominal": {"mjcf": name, "timestep_s": period_s},
        "commands": [
            {"name": f"u_{j}", "joint": j, "unit": "N·m", "limits": [-30.0, 30.0]} for j in driven
        ],
        "observations": [
            {"name": f"{s}_{j}", "joint": j, "field": f, "unit": u}
            for s, f, u in fields
            for j in joints
        ],
        "evaluation": {"horizon_s": 0.4},
    }
    return Plant.from_document(resolved(document, folder))


@cache
def branched_plant():
    """Returns the plant of EVERYTHING, read once; it holds the numbers, and needs no file."""
    with TemporaryDirectory() as folder:
        return plant_of(Path(folder), EVERYTHING, ["a", "b", "c"])


def recorded(plant, change, seeds, roles, seconds=2.0, noise=(2e-4, 3e-3)):
    """Returns episodes of ARM after `change(spec)`, simulated by MuJoCo at a fine step.

    A controller follows slow waves.
    """
    spec = mujoco.MjSpec.from_string(ARM)
    spec.option.timestep = PERIOD_S / FINE
    change(spec)
    model = spec.compile()
    return [
        _episode(plant, model, seed, role, round(seconds / PERIOD_S), noise)
        for seed, role in zip(seeds, roles, strict=True)
    ]


def _episode(plant, model, seed, role, samples, noise):
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    data.qpos[:], t = rng.uniform(-0.4, 0.4, 2), np.arange(samples + 1) * PERIOD_S
    waves = [
        sum(
            a * np.sin(2 * np.pi * f * t + p)
            for a, f, p in rng.uniform((0.1, 0.2, 0.0), (0.5, 1.4, 6.3), (3, 3))
        )
        for _ in range(2)
    ]
    seen, issued = np.empty((samples + 1, 4)), np.empty((samples + 1, 2))
    for i in range(samples + 1):
        state = np.concatenate([data.qpos, data.qvel])
        seen[i] = state + rng.normal(size=4) * np.repeat(noise, 2)
        issued[i] = np.clip(
            np.array([40.0, 15.0]) * ([w[i] for w in waves] - seen[i, :2])
            - np.array([4.0, 1.5]) * seen[i, 2:],
            -25.0,
            25.0,
        )
        data.ctrl[:] = issued[i]
        for _ in range(FINE):
            mujoco.mj_step(model, data)
    conditions = {"stage": "SIL", "loop": "closed"}
    return Episode(t, issued, seen, plant.layout, Role(role), conditions, 0, f"{role}-{seed}")
