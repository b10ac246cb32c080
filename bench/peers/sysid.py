"""mujoco.sysid: masses, centres, dampings, armatures and, where it is told so, friction losses, by
its own least squares on short windows.

A case is a folder with arm.xml and recordings.npz; the answer is what moved furthest from the
model, the squared errors on the test recordings before and after, in units of each channel's
standard deviation, and the time. `python -m bench.peers.sysid CASES OUT [frictionloss]`.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from mujoco import sysid

ITERATIONS = 30
LEAST_FRICTION, MOST_FRICTION = 1e-4, 3.0  # [N m]
FOUND = 0.02  # [N m] of friction loss: less is none


def sensed(xml: str) -> tuple[mujoco.MjSpec, list[str]]:
    """The model with a sensor of each joint's position and velocity, and the joints' names."""
    spec = mujoco.MjSpec.from_string(xml)
    names = [j.name for j in spec.joints]
    for kind, of in (
        ("q", mujoco.mjtSensor.mjSENS_JOINTPOS),
        ("v", mujoco.mjtSensor.mjSENS_JOINTVEL),
    ):
        for name in names:
            spec.add_sensor(
                name=f"{kind}_{name}", type=of, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name
            )
    return spec, names


def parameters(
    spec: mujoco.MjSpec, model: mujoco.MjModel, names: list[str], friction: bool
) -> sysid.ParameterDict:
    """What is free."""
    found = sysid.ParameterDict()
    for name in names:
        at = model.joint(name).dofadr[0]
        for what, nominal in (
            ("damping", model.dof_damping[at]),
            ("armature", model.dof_armature[at]),
        ):
            found.add(
                sysid.Parameter(
                    f"{what} {name}",
                    nominal,
                    0.1 * nominal,
                    10.0 * nominal,
                    modifier=_setter(name, what),
                )
            )
        if friction:
            given = LEAST_FRICTION, LEAST_FRICTION / 2, MOST_FRICTION
            found.add(
                sysid.Parameter(
                    f"frictionloss {name}", *given, modifier=_setter(name, "frictionloss")
                )
            )
        body = model.body(int(model.jnt_bodyid[model.joint(name).id])).name
        found.add(
            sysid.body_inertia_param(
                spec, model, body, sysid.InertiaType.MassIpos, True, param_name=f"mass {name}"
            )
        )
    return found


def _setter(name, what):
    def put(spec, parameter):
        value = float(parameter.value[0])
        setattr(spec.joint(name), what, [value, 0.0, 0.0] if what == "damping" else value)

    return put


def identified(xml: str, z, horizon: int, friction: bool):
    """Its parameters before and after, and the model that they make."""
    spec, names = sensed(xml)
    model = spec.compile()
    n = len(names)
    starts, controls, seen = [], [], []
    for i in range(int(z["adaptation"])):
        t, u, y = (z[f"adaptation{i}{x}"] for x in "tuy")
        for first in range(0, len(t) - horizon, horizon):
            part = slice(first, first + horizon)
            starts.append(
                sysid.create_initial_state(model, y[first, :n], y[first, n:], np.zeros(0))
            )
            controls.append(sysid.TimeSeries(t[part] - t[first], u[part]))
            seen.append(sysid.TimeSeries.from_names(t[part] - t[first], y[part], model))
    sequences = sysid.ModelSequences(
        "arm", spec, [str(i) for i in range(len(starts))], starts, controls, seen
    )
    given = parameters(spec, model, names, friction)
    fitted, _ = sysid.optimize(
        given.copy(),
        sysid.build_residual_fn(models_sequences=[sequences]),
        verbose=False,
        max_iters=ITERATIONS,
    )
    return given, fitted, sysid.apply_param_modifiers(fitted, spec)


def errors(model: mujoco.MjModel, z, horizon: int) -> float:
    """Mean squared error on the test recordings over windows, channels in units of their standard
    deviation."""
    n, missed = model.nq, []
    motion = np.std(np.concatenate([z[f"test{i}y"] for i in range(int(z["test"]))]), axis=0)
    for i in range(int(z["test"])):
        u, y = z[f"test{i}u"], z[f"test{i}y"]
        for first in range(0, len(y) - horizon, horizon):
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:] = y[first, :n], y[first, n:]
            for k in range(first, first + horizon):
                data.ctrl[:] = u[k]
                mujoco.mj_step(model, data)
                missed.append((np.concatenate([data.qpos, data.qvel]) - y[k + 1]) / motion)
    return float(np.mean(np.square(missed)))


def blamed(given: sysid.ParameterDict, fitted: sysid.ParameterDict) -> list[str]:
    """The largest friction loss that was found, else the number that moved furthest: what, and at
    which joint."""
    moved = {
        name: float(np.abs(np.log(p.value[0] / given[name].value[0]))) for name, p in fitted.items()
    }
    rubs = {
        name: float(p.value[0])
        for name, p in fitted.items()
        if name.startswith("frictionloss") and p.value[0] > FOUND
    }
    return max(rubs or moved, key=(rubs or moved).get).split()


def main(cases: Path, out: Path, friction: bool) -> None:
    """Answer every case."""
    for case in sorted(cases.iterdir()):
        z, xml = np.load(case / "recordings.npz"), (case / "arm.xml").read_text()
        horizon, began = int(z["horizon"]), time.perf_counter()
        given, fitted, model = identified(xml, z, horizon, friction)
        seconds = time.perf_counter() - began
        before, after = errors(sensed(xml)[0].compile(), z, horizon), errors(model, z, horizon)
        answer = {
            "blamed": blamed(given, fitted),
            "before": before,
            "after": after,
            "seconds": seconds,
        }
        (out / f"{case.name}.json").write_text(json.dumps(answer))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), "frictionloss" in sys.argv[3:])
