"""First model: a plant.json from recordings alone, for whoever has a log and no declared model.

Topics, joints, fields, rates and the range of the commands are read off the log. The nominal form
is the simplest family that the data do not clearly speak against, with its numbers identified: so a
diagnosis from it says what is missing beyond new numbers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10
from typing import Any

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.layout import Channel, Field, Layout
from trueup.episode.survey import Survey, Surveyed
from trueup.errors import BadPlant, NotIdentifiable
from trueup.fit.identify import identify
from trueup.model.family import families
from trueup.model.plant import Plant

COMMANDED = re.compile(
    r"command|cmd|desired|target|goal|reference|setpoint|effort|torque|control", re.IGNORECASE
)
UNITS = {Field.POSITION: "rad", Field.VELOCITY: "rad/s", Field.EFFORT: "N·m"}
SYMBOLS = {Field.POSITION: "q", Field.VELOCITY: "v", Field.EFFORT: "u"}
SIMPLEST = ("inertia", "pendulum", "oscillator")
CLEARLY = 0.9  # of a simpler family's residual: a family whose own is not below that is not needed
# rollouts are judged over so long, or over such a part of the shortest recording
HORIZON_S, PARTS = 1.0, 5.0


@dataclass(frozen=True, slots=True)
class Chosen:
    """Where the observations and the command of a joint are in a log."""

    observed: Surveyed
    commanded: Surveyed
    joint: str | None
    command_field: Field

    @property
    def layout(self) -> Layout:
        """The plant's channels: the position, the velocity if it is logged, and the command."""
        seen = [f for f in (Field.POSITION, Field.VELOCITY) if f in self.observed.fields]
        observations = tuple(Channel(SYMBOLS[f], UNITS[f], f, self.joint) for f in seen)
        command = Channel("u", UNITS[self.command_field], self.command_field, self.joint)
        return Layout(observations, (command,), self.observed.topic, self.commanded.topic)


def choose(
    survey: Survey,
    *,
    observation: str | None = None,
    command: str | None = None,
    joint: str | None = None,
) -> Chosen:
    """The topics and the joint of a log with one driven joint, those that are named or those that
    are plain. Raises BadPlant."""
    by_name = {s.topic: s for s in survey.topics}
    for name in (observation, command):
        if name is not None and name not in by_name:
            raise BadPlant(f"no JointState is on {name}", field="topics", hint=_there_is(survey))
    seen = by_name[observation] if observation else _observed(survey, command)
    driven = by_name[command] if command else _commanded(survey, seen)
    field = (
        Field.EFFORT if Field.EFFORT in driven.fields else next((f for f in driven.fields), None)
    )
    if field is None:
        raise BadPlant(
            f"{driven.topic} commands nothing: its messages have no values",
            field="commands",
            hint=_there_is(survey),
        )
    joints = (
        [j for j in seen.joints if j in driven.joints]
        if driven.joints and seen.joints
        else list(seen.joints)
    )
    if joint is None and len(joints) > 1:
        hint = f"Name one with --joint ({', '.join(joints)}), or describe the robot by --mjcf."
        raise BadPlant(
            f"the log moves {len(joints)} joints, and a family describes one",
            field="joint",
            hint=hint,
        )
    if joint is not None and joint not in joints:
        raise BadPlant(
            f"no joint {joint!r} is both observed and commanded",
            field="joint",
            hint=f"There are {', '.join(joints) or 'none'}.",
        )
    return Chosen(seen, driven, joint or (joints[0] if joints else None), field)


def _observed(survey: Survey, command: str | None) -> Surveyed:
    seen = [
        s
        for s in survey.topics
        if Field.POSITION in s.fields and s.topic != command and not COMMANDED.search(s.topic)
    ]
    if len(seen) != 1:
        raise BadPlant(
            f"{len(seen)} topics look like observed positions",
            field="topics",
            hint=f"Name one with --observation. {_there_is(survey)}",
        )
    return seen[0]


def _commanded(survey: Survey, seen: Surveyed) -> Surveyed:
    others = [s for s in survey.topics if s.topic != seen.topic and s.fields]
    named = [s for s in others if COMMANDED.search(s.topic)] or others
    if len(named) == 1:
        return named[0]
    if not named and Field.EFFORT in seen.fields:
        return seen  # what the drives measured is all that the log has of the command
    raise BadPlant(
        f"{len(named)} topics look like commands",
        field="topics",
        hint=f"Name one with --command. {_there_is(survey)}",
    )


def _there_is(survey: Survey) -> str:
    streams = [
        f"{s.topic} ({', '.join(s.fields) or 'empty'} of {', '.join(s.joints) or 'unnamed joints'})"
        for s in survey.topics
    ]
    others = (
        f" Other topics: {', '.join(survey.others)}; commands must be JointState, too."
        if survey.others
        else ""
    )
    return f"JointState is on: {'; '.join(streams) or 'no topic'}.{others}"


def describe(
    name: str, chosen: Chosen, episodes: Sequence[Episode], family: str | None = None
) -> dict[str, Json]:
    """A plant.json for adaptation episodes that were read by `chosen.layout`. Raises BadPlant,
    NotIdentifiable."""
    period = min(e.period_s for e in episodes)
    timestep = float(f"{period:.3g}")
    largest = max(float(abs(e.commands).max()) for e in episodes)
    if largest == 0.0:
        raise NotIdentifiable(
            "the command is 0 throughout", hint="Name the topic and the field that drive the joint."
        )
    layout, reach = chosen.layout, _rounded_up(largest)
    document: dict[str, Any] = {
        "name": name,
        "nominal": {
            "family": "",
            "parameters": {},
            "timestep_s": timestep,
            "integrator": "semi_implicit_euler",
        },
        "commands": [_channel(layout.commands[0]) | {"limits": [-reach, reach]}],
        "observations": [_channel(c) | {"scale": 1.0} for c in layout.observations],
        "evaluation": {
            "horizon_s": float(
                f"{min(HORIZON_S, min(float(e.t_s[-1]) for e in episodes) / PARTS):.2g}"
            )
        },
        "topics": {"observation": layout.observation_topic, "command": layout.command_topic},
    }
    fitted = {
        f: identification
        for f in ([family] if family else SIMPLEST)
        if (identification := _fitted(document, f, episodes)) is not None
    }
    if not fitted:
        raise NotIdentifiable(
            "no family's numbers can be identified from this log",
            hint="Record a motion that moves and reverses more.",
        )
    best = next(iter(fitted))
    for other, (_, residual) in fitted.items():
        if residual < CLEARLY * fitted[best][1]:
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
    """To two digits."""
    step = 10.0 ** (floor(log10(x)) - 1)
    return float(f"{ceil(x / step - 1e-9) * step:.2g}")
