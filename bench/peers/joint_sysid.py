"""mujoco.sysid on one-joint machines: the nominal form as an MJCF joint of inertia 1, with its
damping, spring or gravity, drive gain and friction loss free, by its own least squares on windows.

A case is a file `NAME.npz` with recordings and the nominal form; the answer is numbers of the
nominal form, the level of dry friction, and the time. `python -m bench.peers.joint_sysid CASES
OUT`.
"""

from __future__ import annotations

import json

import mujoco
import numpy as np
from mujoco import sysid

from bench.peers.answers import answer_all

ITERATIONS = 40
GRAVITY = 9.81
ARM = 1e-3  # [m] of a pendulum's mass: its own inertia is next to nothing beside 1
FAST = 0.3  # rad squared of a vibration in a step: a first-order step would damp it
REACH = 20.0  # times the nominal number, up and down
MODEL = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -{gravity}" integrator="{integrator}"/>
  <worldbody><body name="link">
    <joint name="joint" type="{kind}" axis="0 1 0" armature="1" damping="{c}" stiffness="{k}"/>
    <inertial pos="0 0 -{arm}" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/>
  </body></worldbody>
  <actuator><motor name="drive" joint="joint" gear="{b}"/></actuator>
  <sensor><jointpos name="q" joint="joint"/><jointvel name="v" joint="joint"/></sensor>
</mujoco>
"""


def spec_of(family: str, numbers: dict[str, float], step: float) -> mujoco.MjSpec:
    """The nominal form as MJCF; of a pendulum the moment of its weight is k."""
    swings = family == "pendulum"
    text = MODEL.format(
        step=step,
        integrator="RK4" if numbers.get("k", 0.0) * step**2 > FAST else "implicitfast",
        gravity=GRAVITY,
        kind="hinge" if swings else "slide",
        c=numbers["c"],
        k=0.0 if swings else numbers.get("k", 0.0),
        b=numbers["b"],
        arm=ARM,
        mass=numbers["k"] / GRAVITY / ARM if swings else 1e-9,
    )
    return mujoco.MjSpec.from_string(text)


def parameters(family: str, numbers: dict[str, float], size: float) -> sysid.ParameterDict:
    """What is free: `size` is that of the motion's acceleration."""
    free = sysid.ParameterDict()
    for name, value in numbers.items():
        free.add(
            sysid.Parameter(name, value, value / REACH, value * REACH, modifier=_set(family, name))
        )
    free.add(sysid.Parameter("friction", 0.02 * size, 0.0, size, modifier=_set(family, "friction")))
    return free


def _set(family: str, name: str):
    def put(spec, parameter):
        value = float(parameter.value[0])
        if name == "b":
            gear = np.zeros(6)
            gear[0] = value
            spec.actuator("drive").gear = gear
        elif name == "k" and family == "pendulum":
            spec.body("link").mass = value / GRAVITY / ARM
        elif name == "k":
            spec.joint("joint").stiffness = [value, 0.0, 0.0]
        elif name == "c":
            spec.joint("joint").damping = [value, 0.0, 0.0]
        else:
            spec.joint("joint").frictionloss = value

    return put


def identified(z) -> dict[str, float]:
    """The fitted numbers of one case."""
    about = json.loads(str(z["about"]))
    spec = spec_of(about["family"], about["parameters"], about["step"])
    model = spec.compile()
    window, every = about["window"], about["every"]
    starts, controls, seen, fastest = [], [], [], []
    for i in range(about["recordings"]):
        t, u, q, v = (z[f"{name}{i}"] for name in ("t", "u", "q", "v"))
        fastest.append(np.std(np.gradient(v, t)))
        for first in range(0, len(t) - window, window * every):
            part = slice(first, first + window)
            starts.append(sysid.create_initial_state(model, q[[first]], v[[first]], np.zeros(0)))
            controls.append(sysid.TimeSeries(t[part] - t[first], u[part, None]))
            shown = np.stack([q[part], v[part]], axis=1)
            seen.append(sysid.TimeSeries.from_names(t[part] - t[first], shown, model))
    sequences = sysid.ModelSequences(
        "joint", spec, [str(i) for i in range(len(starts))], starts, controls, seen
    )
    free = parameters(about["family"], about["parameters"], float(np.mean(fastest)))
    fitted, _ = sysid.optimize(
        free, sysid.build_residual_fn(models_sequences=[sequences]), verbose=False,
        max_iters=ITERATIONS,
    )  # fmt: skip
    return {name: float(p.value[0]) for name, p in fitted.items()}


if __name__ == "__main__":
    answer_all(identified)
