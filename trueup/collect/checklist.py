"""Checklist: what a person must check before a designed command is played on a machine."""

from __future__ import annotations

from trueup.collect.bounds import DECLARED, GIVEN, RECORDED, UNBOUNDED
from trueup.collect.excitation import Excitation
from trueup.episode.layout import Channel
from trueup.model.plant import Plant

WHENCE = {DECLARED: "declared in plant.json", RECORDED: "as recorded, for no envelope is declared", GIVEN: "as asked for"}
SPEED_WHENCE = {**WHENCE, RECORDED: "as recorded"}


def checks(plant: Plant, found: Excitation, *, diagnosed: bool) -> list[str]:
    """Sentences, the one that comes first in time first; `diagnosed` is whether the models in play are those that a diagnosis left."""
    return [
        _begin(plant, found),
        *_travel(plant, found),
        *_speed(plant, found),
        *_command(plant, found),
        _end(plant, found),
        _models(diagnosed),
    ]


def _begin(plant: Plant, found: Excitation) -> str:
    joints = len(found.hold)
    where = ", ".join(f"{_position(plant, j).name} = {found.start[j]:.4g} {_position(plant, j).unit}" for j in range(joints))
    held = ", ".join(f"{c.name} = {found.hold[plant.joint_of(c)]:.4g} {c.unit}" for c in plant.layout.commands)
    return f"Bring the machine to rest at {where}, under the command {held}: the design begins there."


def _travel(plant: Plant, found: Excitation) -> list[str]:
    said = []
    for j in range(len(found.hold)):
        (low, high), whence = found.bounds.whole()[j], WHENCE[found.bounds.sources[j]]
        free, position = 100 * found.bounds.margin, _position(plant, j)
        said.append(
            f"See that {position.name} may go from {low:.4g} to {high:.4g} {position.unit} ({whence}); {free:.0f} % of it is kept free."
        )
    return said


def _speed(plant: Plant, found: Excitation) -> list[str]:
    joints, said = len(found.hold), []
    for j in range(joints):
        low, high = found.bounds.whole()[joints + j]
        of = f"The speed of {plant.joint_name(j)}"
        if found.bounds.sources[joints + j] == UNBOUNDED:
            said.append(f"{of} is not bounded: none is recorded or declared; --speed bounds it.")
        else:
            whence = SPEED_WHENCE[found.bounds.sources[joints + j]]
            said.append(f"{of} stays between {low:.4g} and {high:.4g} {_position(plant, j).unit}/s ({whence}).")
    return said


def _command(plant: Plant, found: Excitation) -> list[str]:
    said = []
    for channel in plant.layout.commands:
        j = plant.joint_of(channel)
        low, high = found.command[:, j].min(), found.command[:, j].max()
        whence = {RECORDED: "as recorded", GIVEN: "as asked for", UNBOUNDED: "by the band alone: none is recorded"}[
            found.bounds.rate_source
        ]
        said.append(
            f"The command {channel.name} goes from {low:.4g} to {high:.4g} {channel.unit} and changes by at most "
            f"{found.bounds.rate[j]:.4g} {channel.unit}/s ({whence})."
        )
    return said


def _end(plant: Plant, found: Excitation) -> str:
    speeds = ", ".join(f"{x:.2g} {_position(plant, j).unit}/s" for j, x in enumerate(found.speed_at_end))
    if found.rests:
        return f"It ends at rest under every one of {len(found.paths)} models: none is faster than {speeds}."
    return f"It does NOT end at rest: under one of {len(found.paths)} models the machine still moves at {speeds}. Be ready to stop it."


def _models(diagnosed: bool) -> str:
    left, guessed = "those that the diagnosis left", "the nominal numbers and a spread about them, which no diagnosis has confirmed"
    return (
        f"The models are {left if diagnosed else guessed}. A stop, an obstacle or a load that none of them has is not foreseen: whoever "
        "plays this keeps a hand on an emergency stop that does not depend on this command."
    )


def _position(plant: Plant, joint: int) -> Channel:
    """The channel that observes a joint's position."""
    return next(c for c, column in zip(plant.layout.observations, plant.state_columns, strict=True) if column == joint)
