"""First model: a plant.json from recordings alone, for whoever has a log and no declared model.

Rates and the range of the commands are read off the episodes. The nominal form is the simplest
family that the data do not clearly speak against, with its numbers identified: so a diagnosis from
it says what is missing beyond other parameters. A joint that is commanded by positions is an
oscillator about its command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, floor, log10
from typing import Any

import numpy as np

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.layout import Channel, Field, Layout
from trueup.episode.role import Role
from trueup.errors import BadPlant, NotIdentifiable
from trueup.fit.identify import identify
from trueup.model.family import families
from trueup.model.plant import Plant

SIMPLEST = ("inertia", "pendulum", "oscillator")
CONSTANT = "it is not what drives the joint"
OTHERWISE = (
    "Name another signal with --signal.u (in Python u=), or with --names the joints of a list that "
    "has no names."
)
SERVO = ("oscillator",)  # a joint that is commanded by positions swings about its command
CLEARLY = 0.9  # of a simpler family's residual: a family whose own is not below that is not needed
# rollouts are judged over so long, or over such a part of the shortest recording
HORIZON_S, PARTS = 1.0, 5.0


def describe(
    name: str, layout: Layout, episodes: Sequence[Episode], family: str | None = None
) -> dict[str, Json]:
    """A plant.json of one joint for episodes of this layout, whose numbers are those of the
    adaptation episodes. Raises BadPlant, NotIdentifiable."""
    document = undriven(name, layout, episodes)
    used = [e for e in episodes if e.role is Role.ADAPTATION]
    tried: tuple[str, ...] = SIMPLEST
    if layout.commands[0].field is Field.POSITION:
        tried = SERVO
    fitted = {
        f: identification
        for f in ([family] if family else tried)
        if (identification := _fitted(document, f, used)) is not None
    }
    if not fitted:
        raise NotIdentifiable(
            "no family's numbers can be identified from this log",
            hint="Record a motion that moves and reverses more.",
        )
    best = next(iter(fitted))
    for other, (numbers, residual) in fitted.items():
        as_many = len(numbers) == len(fitted[best][0])  # of as many numbers the nearer one is taken
        if residual < (1.0 if as_many else CLEARLY) * fitted[best][1]:
            best = other
    document["nominal"] |= {
        "family": best,
        "parameters": {k: float(f"{v:.6g}") for k, v in fitted[best][0].items()},
    }
    return document


def _fitted(
    document: Mapping[str, Any], family: str, episodes: Sequence[Episode]
) -> tuple[dict[str, float], float] | None:
    """A family's numbers and the residual that they leave; None where the data do not determine
    them."""
    if family not in families():
        raise BadPlant(
            f"there is no family {family!r}",
            field="nominal.family",
            hint=f"There are {', '.join(families())}.",
        )
    nominal = {
        **document["nominal"],
        "family": family,
        "parameters": {p.name: 1.0 for p in families()[family].params},
    }
    try:
        _, identification = identify(
            Plant.from_document({**document, "nominal": nominal}), episodes
        )
    except NotIdentifiable:
        return None
    return identification.parameters, identification.residual_rms


def _channel(c: Channel) -> dict[str, Any]:
    return {
        "name": c.name,
        "unit": c.unit,
        "field": str(c.field),
        **({"joint": c.joint} if c.joint else {}),
    }


def _rounded_up(x: float) -> float:
    """To four digits."""
    step = 10.0 ** (floor(log10(x)) - 3)
    return float(f"{ceil(x / step - 1e-9) * step:.4g}")


def describe_robot(
    name: str, layout: Layout, episodes: Sequence[Episode], model: str
) -> dict[str, Json]:
    """A plant.json of a robot whose model is the MJCF or URDF file `model` beside it, for episodes
    of this layout. Raises NotIdentifiable."""
    document = undriven(name, layout, episodes)
    document["nominal"] = {"mjcf": model, "timestep_s": document["nominal"]["timestep_s"]}
    return document


def undriven(name: str, layout: Layout, episodes: Sequence[Episode]) -> dict[str, Any]:
    """A plant.json whose nominal model is still to be said. Raises NotIdentifiable."""
    period = min(e.period_s for e in episodes)
    reaches = [
        max(float(abs(e.commands[:, i]).max()) for e in episodes)
        for i in range(len(layout.commands))
    ]
    if not any(e.commands[:, i].any() for e in episodes for i in range(len(layout.commands))):
        raise NotIdentifiable(f"the command is 0 throughout: {CONSTANT}", hint=OTHERWISE)
    if all(np.ptp(e.commands, axis=0).max() == 0.0 for e in episodes):
        raise NotIdentifiable(f"the command is constant throughout: {CONSTANT}", hint=OTHERWISE)
    horizon = min(HORIZON_S, min(float(e.t_s[-1]) for e in episodes) / PARTS)
    return {
        "name": name,
        "nominal": {
            "family": "",
            "parameters": {},
            "timestep_s": float(f"{period:.3g}"),
            "integrator": "semi_implicit_euler",
        },
        "commands": [
            _channel(c) | {"limits": [-reach, reach]}
            for c, largest in zip(layout.commands, reaches, strict=True)
            for reach in [_rounded_up(largest or max(reaches))]
        ],
        "observations": [_channel(c) | {"scale": 1.0} for c in layout.observations],
        "evaluation": {"horizon_s": float(f"{horizon:.2g}")},
        "topics": {"observation": layout.observation_topic, "command": layout.command_topic},
    }
