"""Magnitude of an imperfection, by the gap that it makes.

The imperfection's numbers grow from nothing with one magnitude, in proportion to a joint's own
motion and forces, and the magnitude is bisected.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from trueup.simulate.machine import Machine
from trueup.simulate.robot import RobotMachine

Array = NDArray[np.float64]
AnyMachine = TypeVar("AnyMachine", Machine, RobotMachine)
# of each number: at magnitude 0, its growth, and whether it falls instead
Shape = Mapping[str, tuple[float, float, bool]]
ROUNDS = 18  # of bisection for a magnitude
CLOSE = 0.1  # of what is wanted: close enough for a lot
# times the motion without it: a drive that an imperfection makes unstable is no machine that
# anybody logs
SHAKEN = 1.5


def shape_of(
    name: str, s: Mapping[str, float], rng: np.random.Generator, *, hardens: bool
) -> dict[str, tuple[float, float, bool]]:
    """For each number of an imperfection: its value at magnitude 0, its growth with magnitude, and
    whether it falls with magnitude instead. `s` are the sizes of the joint's motion and forces; a
    cubic spring `hardens` where nothing else holds the joint."""
    a, q, v, u, t = s["acceleration"], s["position"], s["velocity"], s["command"], s["time"]
    sign = float(rng.choice([-1.0, 1.0]))
    odd = float(name == "quadratic_gain" and rng.random() < 0.5)  # noqa: PLR2004

    def grows(by: float, at: float = 0.0) -> tuple[float, float, bool]:
        return (at, by, False)

    def fixed(value: float) -> tuple[float, float, bool]:
        return (value, 0.0, False)

    def shrinks(by: float) -> tuple[float, float, bool]:
        return (by, 0.0, True)

    shapes: dict[str, dict[str, tuple[float, float, bool]]] = {
        "coulomb_friction": {"level": grows(a)},
        "stribeck_friction": {
            "level": grows(0.4 * a),
            "extra": grows(a * rng.uniform(0.4, 1.0)),
            "speed": fixed(v * rng.uniform(0.1, 0.4)),
        },
        "quadratic_drag": {"coefficient": grows(a / v**2)},
        "cubic_stiffness": {"coefficient": grows(a / q**3 * (1.0 if hardens else sign) * 0.3)},
        "constant_force": {"level": grows(a * sign)},
        "hysteresis": {"level": grows(a), "distance": fixed(q * rng.uniform(0.15, 0.6))},
        "hard_stop": {
            "limit": shrinks(s["travel"]),
            "stiffness": fixed(400.0 * a / q),
            "damping": fixed(5.0 * a / v),
        },
        "cogging": {
            "amplitude": grows(a),
            "pitch": fixed(q * rng.uniform(0.3, 1.2)),
            "phase": fixed(rng.uniform(0, 6.28)),
        },
        "elastic_transmission": {
            "stiffness": shrinks(40.0 / t**2),
            "damping": fixed(0.15 / t),
            "share": fixed(rng.uniform(0.15, 0.5)),
        },
        "load_dependent_friction": {"coefficient": grows(1.0)},
        "asymmetric_viscous_friction": {"difference": grows(a / v * sign)},
        "deadband": {"width": grows(u)},
        "backlash": {"gap": grows(u)},
        "actuator_lag": {"time_constant": grows(t)},
        "actuator_delay": {"delay": grows(t)},
        "saturation": {"limit": shrinks(u)},
        "rate_limit": {"rate": shrinks(20.0 * u / t)},
        "thermal_derating": {"loss": grows(1.0), "time_constant": fixed(rng.uniform(1.5, 6.0))},
        "gain_asymmetry": {"asymmetry": grows(sign)},
        "command_quantization": {"step": grows(u)},
        "quadratic_gain": {"odd": grows(0.7 * sign * odd), "even": grows(0.7 * sign * (1.0 - odd))},
        "sensor_delay": {"delay": grows(t)},
        "sensor_bias": {"bias": grows(q * sign)},
        "sensor_scale": {"error": grows(sign)},
        "sensor_quantization": {"step": grows(q), "velocity_step": fixed(0.0)},
        "sensor_drift": {"rate": grows(q / 8.0 * sign)},
        "clock_skew": {"skew": grows(sign)},
        "dropped_frames": {"fraction": fixed(rng.uniform(0.05, 0.3))},
        "velocity_lag": {"time_constant": grows(t)},
        "k_modulated": {"depth": grows(1.0), "rate": fixed(rng.uniform(0.7, 2.5))},
        "van_der_pol": {"strength": grows(a / v), "width": fixed(q)},
        "position_damping": {"coefficient": grows(a / v / q)},
        "torque_speed": {"loss": grows(0.3 / v)},
        "hidden_mode": {
            "stiffness": grows(a / q),
            "damping": fixed(0.02 * a / v),
            "share": fixed(rng.uniform(0.1, 0.4)),
        },
        "viscoelastic": {
            "stiffness": grows(a / q),
            "time_constant": fixed(t * rng.uniform(0.5, 2.0)),
        },
        "asymmetric_stiffness": {"change": grows(sign)},
        "growing_friction": {"rate": grows(a / 8.0)},
    }
    return shapes[name]


def as_large_as(
    machine: AnyMachine,
    name: str,
    shape: Shape,
    wanted: float,
    observe: Callable[[AnyMachine], Array],
    column: int,
    joint: int = 0,
) -> tuple[AnyMachine, float]:
    """The machine with one more imperfection, and the gap that it makes.

    The magnitude is bisected until the imperfection moves an observed column by `wanted`, relative
    to the column's motion. The gap is 0 where the imperfection only makes the machine shake.
    """
    without = observe(machine)
    low, high, best, reached = 0.0, 1.0, machine, 0.0  # the largest that is not too large
    grows = any(by or falls for _, by, falls in shape.values())
    for _ in range(ROUNDS if grows else 1):
        size = 0.5 * (low + high)
        tried = machine.having(
            name,
            {
                key: at * (1.0 - size) if falls else at + by * size
                for key, (at, by, falls) in shape.items()
            },
            joint,
        )
        with_it = observe(tried)
        with np.errstate(over="ignore", invalid="ignore"):  # a machine that runs away is too much
            gap = float(
                np.sqrt(np.mean((with_it - without)[:, column] ** 2)) / without[:, column].std()
            )
            sane = bool((with_it.std(axis=0) < SHAKEN * without.std(axis=0)).all())
        gap = gap if sane else np.inf
        if gap > (1.0 + CLOSE) * wanted:
            high = size
        else:
            low, best, reached = size, tried, gap
            if gap > (1.0 - CLOSE) * wanted:
                break
    if best is machine:  # none was small enough: the smallest
        best, reached = tried, gap if np.isfinite(gap) else 0.0
    return best, reached
