"""A picture of each effect, as people in the field draw it, made by the effect's own function."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.effect import Effect, Port, effects
from trueup.model.families.inertia import Inertia
from trueup.model.joint_effects import JointEffects
from trueup.model.joint_step import JointStep
from trueup_cli.pictures.drawing import (
    PALE,
    SERIES,
    WIDTH,
    Panel,
    legend,
    nice,
    range_of,
    sheet,
    text,
)

Array = NDArray[np.float64]
PERIOD_S, SECONDS = 0.01, 8.0
TOP, HEIGHT_PX = 104, 230
FOLDER = Path(__file__).parent / "pictures" / "effects"
# drawn as output over input
LOOPS = (
    "backlash",
    "command_quantization",
    "deadband",
    "gain_asymmetry",
    "quadratic_gain",
    "saturation",
)
OVER_POSITION = ("cogging", "cubic_stiffness", "hard_stop", "hysteresis")
# numbers that show the effect in a motion and a command of size 1
# of effects whose largest initial guess makes no good picture
NUMBERS: dict[str, tuple[float, ...]] = {
    "actuator_delay": (0.4,),
    "actuator_lag": (0.4,),
    "asymmetric_viscous_friction": (0.6,),
    "backlash": (0.5,),
    "clock_skew": (0.08,),
    "cogging": (0.3, 0.0, 0.4),
    "command_quantization": (0.25,),
    "constant_force": (0.3,),
    "coulomb_friction": (0.3,),
    "cubic_stiffness": (0.8,),
    "deadband": (0.25,),
    "dropped_frames": (0.4,),
    "elastic_transmission": (0.9, 0.1, 0.3),
    "gain_asymmetry": (0.3,),
    "hard_stop": (0.8, 30.0, 1.0, 0.0, 0.5),
    "hysteresis": (0.3, 0.15, 0.5, 0.5),
    "load_dependent_friction": (0.4, 0.4, 0.1),
    "quadratic_drag": (0.6,),
    "quadratic_gain": (0.3, 0.15),
    "rate_limit": (0.9,),
    "saturation": (0.6,),
    "sensor_bias": (0.25,),
    "sensor_delay": (0.4,),
    "sensor_drift": (0.06,),
    "sensor_quantization": (0.25, 0.25),
    "sensor_scale": (0.25,),
    "stribeck_friction": (0.25, 0.35, 0.12, 0.5),
    "thermal_derating": (0.9, 3.0, 0.05),
    "velocity_lag": (0.3,),
}


def picture(effect: type[Effect]) -> str:
    """The effect's picture."""
    title, x, lines, label = _drawn(effect)
    low, high = range_of([values for _, values in lines])
    panel = Panel(TOP, HEIGHT_PX, nice(*range_of([x])), nice(min(low, 0.0), max(high, 0.0)))
    colours = [PALE, SERIES[0]] if len(lines) > 1 else [SERIES[0]]
    parts = [
        legend([(name, colour) for (name, _), colour in zip(lines, colours, strict=True)], 80),
        panel.frame(label[1], times=True),
        *(
            panel.line(x, values, colour, width=2.4)
            for (_, values), colour in zip(lines, colours, strict=True)
        ),
        text(WIDTH / 2, TOP + HEIGHT_PX + 42, label[0], PALE, anchor="middle"),
    ]
    return sheet(effect.name.replace("_", " "), title, TOP + HEIGHT_PX + 56, parts) + "\n"


Drawn = tuple[str, Array, list[tuple[str, Array]], tuple[str, str]]


def _drawn(effect: type[Effect]) -> Drawn:
    numbers = NUMBERS.get(effect.name, np.nan_to_num(effect.starts[-1]))
    values = dict(zip((n.name for n in effect.params), map(float, numbers), strict=True))
    told = ", ".join(f"{name.replace('_', ' ')} {x:g}" for name, x in values.items())
    of_port: dict[
        Port,
        Callable[
            [type[Effect], dict[str, float]], tuple[Array, list[tuple[str, Array]], tuple[str, str]]
        ],
    ] = {
        Port.TIMING: _clock,
        Port.COMMAND: _command,
        Port.FORCE: _force,
        Port.FRICTION: _force,
        Port.OBSERVATION: _seen,
    }
    return (
        told,
        *(_rung if effect.name == "elastic_transmission" else of_port[effect.port])(effect, values),
    )


def _times() -> Array:
    return np.arange(0.0, SECONDS, PERIOD_S)


def _clock(
    _: type[Effect], values: dict[str, float]
) -> tuple[Array, list[tuple[str, Array]], tuple[str, str]]:
    t = _times()
    lines = [
        ("by the log's clock", np.sin(2.0 * t)),
        ("by the machine's", np.sin(2.0 * (1.0 + values["skew"]) * t)),
    ]
    return t, lines, ("time [s]", "position")


def _command(
    effect: type[Effect], values: dict[str, float]
) -> tuple[Array, list[tuple[str, Array]], tuple[str, str]]:
    t = _times()
    steps = np.where(np.mod(t, 4.0) < 2.0, 1.0, -1.0)  # noqa: PLR2004
    issued = (
        np.sin(2.0 * np.pi * t / 4.0)
        if effect.name in LOOPS or effect.name == "thermal_derating"
        else steps
    )
    if effect.delays():
        late = round(values["delay"] / PERIOD_S)
        return (
            t,
            [
                ("issued", issued),
                ("applied", np.concatenate([np.full(late, issued[0]), issued[:-late]])),
            ],
            ("time [s]", "command"),
        )
    memory = {
        state: issued[0] if begins == "u" else 0.0
        for state, begins in zip(effect.states, effect.begins, strict=True)
    }
    applied = []
    for at, u in zip(t, issued, strict=True):
        given: dict[str, Any] = {
            "u": u,
            "q": np.sin(np.pi * at / 2.0),
            "v": np.cos(np.pi * at / 2.0),
            "t": at,
            "h": PERIOD_S,
            "u_scale": 1.0,
            "implicit": 1.0,
            **values,
            **memory,
        }
        found = effect.apply(*(given[name] for name in effect.arguments()))
        applied.append(found[0] if effect.states else found)
        memory = dict(zip(effect.states, found[1:], strict=True)) if effect.states else memory
    if effect.name in LOOPS:
        settled = slice(round(4.0 / PERIOD_S), None)
        return (
            issued[settled],
            [("as issued", issued[settled]), ("applied", np.array(applied)[settled])],
            ("issued command", "command"),
        )
    return t, [("issued", issued), ("applied", np.array(applied))], ("time [s]", "command")


def _force(
    effect: type[Effect], values: dict[str, float]
) -> tuple[Array, list[tuple[str, Array]], tuple[str, str]]:
    t = _times()
    q, v = np.sin(np.pi * t / 2.0), np.cos(np.pi * t / 2.0)
    memory, found = dict.fromkeys(effect.states, 0.0), []
    for at, speed in zip(q, v, strict=True):
        drive = 0.6 + 0.4 * at  # the load of a drive that lifts
        given: dict[str, Any] = {
            "a": 0.0,
            "q": at,
            "v": speed,
            "h": PERIOD_S,
            "implicit": 1.0,
            "mobility": 1.0,
            "drive": drive,
        }
        given |= {"passive": -0.2 * speed, "spring": -0.4 * at, **values, **memory}
        answer = effect.apply(*(given[name] for name in effect.arguments()))
        memory = dict(zip(effect.states, answer[1:], strict=True)) if effect.states else memory
        first = answer[0] if effect.states else answer
        found.append(-np.sign(speed) * first if effect.port is Port.FRICTION else first)
    settled = slice(round(4.0 / PERIOD_S), None)
    x, label = (q, "position") if effect.name in OVER_POSITION else (v, "velocity")
    return x[settled], [("force of the effect", np.array(found)[settled])], (label, "acceleration")


def _rung(
    effect: type[Effect], values: dict[str, float]
) -> tuple[Array, list[tuple[str, Array]], tuple[str, str]]:
    """A drive that jumps, and how the load's speed answers."""
    t, speeds = _times(), []
    for acting in ((), ((effect, values),)):
        step = JointStep(Inertia, (0.8, 1.0), [JointEffects(acting, 1.0, PERIOD_S)], 0.5)
        q, v, found = [0.0], [0.0], []
        memory = step.begin(v, [0.0])
        for now in t:
            found.append(v[0])
            u = [1.0 if now < SECONDS / 2.0 else -1.0]
            q, v, memory = step.advance(q, v, memory, u, PERIOD_S)
        speeds.append(np.array(found))
    return (
        t,
        [("stiff", speeds[0]), ("elastic", speeds[1])],
        ("time [s]", "velocity under a drive that jumps"),
    )


def _seen(
    effect: type[Effect], values: dict[str, float]
) -> tuple[Array, list[tuple[str, Array]], tuple[str, str]]:
    t = _times()
    q, v = np.sin(1.5 * t), 1.5 * np.cos(1.5 * t)
    if effect.counted and effect.delays():  # lost frames repeat the last one
        arrived = np.random.default_rng(1).random(len(t)) >= 0.9  # noqa: PLR2004
        return (
            t,
            [
                ("true", q),
                ("logged", q[np.maximum.accumulate(np.where(arrived, np.arange(len(t)), 0))]),
            ],
            ("time [s]", "position"),
        )
    if effect.delays():
        return (
            t,
            [("true", q), ("logged", np.sin(1.5 * np.maximum(t - values["delay"], 0.0)))],
            ("time [s]", "position"),
        )
    joint, shown = JointEffects([(effect, values)], 1.0, PERIOD_S), []
    memory = joint.begin(v[0], 0.0)
    for at, speed, now in zip(q, v, t, strict=True):
        *both, memory = joint.shown(at, speed, memory, now)
        shown.append(both)
    column, label = (1, "velocity") if effect.hides_velocity else (0, "position")
    return (
        t,
        [("true", (q, v)[column]), ("logged", np.array(shown)[:, column])],
        ("time [s]", label),
    )


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    for one in effects().values():
        (FOLDER / f"{one.name}.svg").write_text(picture(one))
