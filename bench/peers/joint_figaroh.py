"""FIGAROH on one-joint machines: least squares of the inverse dynamics over its regressor with
viscous and dry friction and an offset, from positions that were low-passed and differentiated both
ways.

It has no spring between a joint and the ground, so it cannot say anything of an oscillator. A case
is a file `NAME.npz` as of joint_sysid. `python -m bench.peers.joint_figaroh CASES OUT`.
"""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from figaroh.tools.regressor import RegressorBuilder, RegressorConfig
from figaroh.tools.solver import solve_linear_system
from scipy.signal import butter, filtfilt

from bench.peers.answers import answer_all

GRAVITY = 9.81
ORDER, CUTOFF_HZ, NYQUIST_PART = 4, 20.0, 0.2
# columns of its regressor: mass, first moment along the arm, second moment about the hinge; then
# viscous and dry friction and the offset
MASS, SIDEWAYS, HANGING, TURNING, VISCOUS, DRY, OFFSET = 0, 1, 3, 6, 10, 11, 12
USED = {
    "inertia": [MASS, VISCOUS, DRY, OFFSET],
    "pendulum": [TURNING, SIDEWAYS, HANGING, VISCOUS, DRY, OFFSET],
}


def robot_of(family: str) -> SimpleNamespace:
    """One body on a slider, or hanging from a hinge, as the regressor's builder takes it."""
    model = pin.Model()
    kind = pin.JointModelRY() if family == "pendulum" else pin.JointModelPY()
    joint = model.addJoint(0, kind, pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    data = model.createData()
    backend = SimpleNamespace(
        nq=1,
        nv=1,
        get_inertias=model.inertias.tolist,
        compute_regressor=lambda q, v, a: pin.computeJointTorqueRegressor(model, data, q, v, a),
    )
    return SimpleNamespace(backend=backend)


def motion(t, q):
    """Position, velocity and acceleration, low-passed both ways."""
    period = float(np.median(np.diff(t)))
    cutoff = min(CUTOFF_HZ, NYQUIST_PART * 0.5 / period)
    smooth = filtfilt(*butter(ORDER, 2.0 * cutoff * period), q)
    v = np.gradient(smooth, t)
    return smooth, v, np.gradient(v, t), round(0.25 / cutoff / period)


def identified(z) -> dict[str, float] | None:
    """The fitted numbers of one case; None where the nominal form has a spring."""
    about = json.loads(str(z["about"]))
    if about["family"] == "oscillator":
        return None
    robot = robot_of(about["family"])
    builder = RegressorBuilder(
        robot, RegressorConfig(has_friction=True, has_joint_offset=True, additional_columns=3)
    )
    rows, commands = [], []
    for i in range(about["recordings"]):
        q, v, a, every = motion(z[f"t{i}"], z[f"q{i}"])
        kept = slice(10 * every, len(q) - 10 * every, every)
        rows.append(
            builder.build_basic_regressor(
                q[kept, None], v[kept, None], a[kept, None], {"act_idxv": [0]}
            )
        )
        commands.append(z[f"u{i}"][kept])
    design, torque = np.concatenate(rows), np.concatenate(commands)
    used = USED[about["family"]]
    solved = solve_linear_system(design[:, used], torque)
    solution = solved[0] if isinstance(solved, tuple) else solved
    found = dict(zip(used, np.asarray(solution).ravel(), strict=True))
    inertia = found[used[0]]
    numbers = {"b": 1.0 / inertia, "c": found[VISCOUS] / inertia}
    if about["family"] == "pendulum":
        numbers["k"] = -GRAVITY * found[HANGING] / inertia
    return {**numbers, "friction": max(found[DRY] / inertia, 0.0)}


if __name__ == "__main__":
    answer_all(identified)
