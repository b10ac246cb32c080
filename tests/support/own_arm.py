"""The arm of `robots.ARM` as a simulator of one's own: two links in a plane, in closed form."""

import mujoco
import numpy as np

from tests.support.robots import ARM, PERIOD_S, arm_document
from trueup.model.plant import Plant
from trueup.model.simulator.simulator import offer

GRAVITY, LENGTH, CENTRE = 9.81, 0.3, 0.15
JOINTS = ["shoulder", "elbow"]


def numbers():
    """Returns what the arm's motion depends on, from its MJCF."""
    model = mujoco.MjModel.from_xml_string(ARM)
    (m1, m2), (i1, i2) = model.body_mass[1:], model.body_inertia[1:, 1]
    armature = model.dof_armature
    return {
        "upper": i1 + m1 * CENTRE**2 + m2 * LENGTH**2 + armature[0],
        "lower": i2 + m2 * CENTRE**2,
        "coupling": m2 * LENGTH * CENTRE,
        "armature": armature[1],
        "weight_upper": (m1 * CENTRE + m2 * LENGTH) * GRAVITY,
        "weight_lower": m2 * CENTRE * GRAVITY,
        "damping_shoulder": model.dof_damping[0],
        "damping_elbow": model.dof_damping[1],
    }


def step(state, command, parameters, force, h_s):
    """States `(lanes, 4)` a symmetric step of `h_s` [s] later, under torques `(lanes, 2)`."""
    p, h = parameters, h_s[:, None]
    v = state[:, 2:]
    q = state[:, :2] + 0.5 * h * v
    coupling, sine = p["coupling"] * np.cos(q[:, 1]), p["coupling"] * np.sin(q[:, 1])
    corner = p["lower"] + coupling
    mass = np.empty((len(q), 2, 2))
    mass[:, 0, 0] = p["upper"] + corner + coupling
    mass[:, 0, 1] = mass[:, 1, 0] = corner
    mass[:, 1, 1] = p["lower"] + p["armature"]
    damping = np.stack([p["damping_shoulder"], p["damping_elbow"]], axis=1)
    mass += 0.5 * h[..., None] * damping[..., None] * np.eye(2)
    below = p["weight_lower"] * np.cos(q.sum(axis=1))
    weight = np.stack([p["weight_upper"] * np.cos(q[:, 0]) + below, below], axis=1)
    still = command + force + weight - damping * v

    def thrown(speed):
        first, second = speed.T
        return np.stack([sine * second * (2.0 * first + second), -sine * first**2], axis=1)

    middle = v + 0.5 * h * np.linalg.solve(mass, (still + thrown(v))[..., None])[..., 0]
    after = v + h * np.linalg.solve(mass, (still + thrown(middle))[..., None])[..., 0]
    return np.concatenate([q + 0.5 * h * after, after], axis=1)


def own_arm(**more):
    """Returns the arm's plant, whose nominal model is the simulator."""
    nominal = {
        "simulator": "arm", "sha256": offer(step), "parameters": numbers(), "joints": JOINTS,
        "timestep_s": PERIOD_S,
    }  # fmt: skip
    return Plant.from_document(arm_document(nominal=nominal, **more))
