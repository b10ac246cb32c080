"""A simulator of one's own: a motor that swings a pendulum, many simulations at once."""

import numpy as np


def step(state, command, parameters, force, h_s):
    """States `(lanes, 2)` a step of `h_s` [s] later, under commands `(lanes, 1)` [A] and forces
    `(lanes, 1)` [N·m]."""
    q, v = state.T
    p = parameters
    torque = p["kt"] * command[:, 0] + force[:, 0] - p["damping"] * v - p["mgl"] * np.sin(q)
    v = v + h_s * torque / p["inertia"]
    return np.column_stack([q + h_s * v, v])
