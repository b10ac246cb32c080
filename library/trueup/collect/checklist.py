"""Checklist: what a person must check before a designed command is played on a machine, and the
command as a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from io import StringIO

import numpy as np
from numpy.typing import NDArray

from trueup.collect.bounds import BAND, DECLARED, GIVEN, RECORDED, UNBOUNDED
from trueup.collect.excitation import Excitation
from trueup.episode.layout import Channel
from trueup.model.plant import Plant

Array = NDArray[np.float64]
LEAST = 1e-300  # to divide by
WHENCE = {
    DECLARED: "declared in plant.json",
    RECORDED: "as recorded, for no envelope is declared",
    GIVEN: "as asked for",
}
SPEED_WHENCE = {**WHENCE, RECORDED: "as recorded"}
RATE_WHENCE = {RECORDED: "as recorded", GIVEN: "as asked for", BAND: "by the band alone"}


def checks(plant: Plant, excitation: Excitation, *, diagnosed: bool) -> list[str]:
    """The checks as sentences, in the order of time. `diagnosed` says that the models in play are
    those that a diagnosis left."""
    return [
        _begin(plant, excitation),
        *_travel(plant, excitation),
        *_speed(plant, excitation),
        *_command(plant, excitation),
        _end(plant, excitation),
        _models(diagnosed),
    ]


def begins_at(plant: Plant, state: Array) -> str:
    """The positions of a state `(2 x joints,)` in words."""
    return ", ".join(
        f"{_position(plant, j).name} = {state[j]:.4g} {_position(plant, j).unit}"
        for j in range(len(plant.joints))
    )


def command_table(plant: Plant, t_s: Array, command: Array, first: Sequence[str]) -> str:
    """A command `(samples, joints)` as CSV: `t` [s], then each command channel in its own unit;
    before it, as comments, what to check."""
    text = StringIO(newline="")
    text.writelines(f"# {line}\r\n" for line in first)
    writer = csv.writer(text)
    writer.writerow(["t", *(c.name for c in plant.layout.commands)])
    columns = command[:, [plant.joint_of(c) for c in plant.layout.commands]]
    writer.writerows(
        [repr(float(t)), *(repr(float(u)) for u in row)]
        for t, row in zip(t_s, columns, strict=True)
    )
    return text.getvalue()


def _begin(plant: Plant, excitation: Excitation) -> str:
    hold = ", ".join(
        f"{c.name} = {excitation.hold[plant.joint_of(c)]:.4g} {c.unit}"
        for c in plant.layout.commands
    )
    return (
        f"Bring the machine to rest at {begins_at(plant, excitation.start)}, under the command "
        f"{hold}: the design begins there."
    )


def _travel(plant: Plant, excitation: Excitation) -> list[str]:
    sentences = []
    for j in range(len(excitation.hold)):
        (low, high), whence = excitation.bounds.whole()[j], WHENCE[excitation.bounds.sources[j]]
        free, position = 100 * excitation.bounds.margin, _position(plant, j)
        sentences.append(
            f"See that {position.name} may go from {low:.4g} to {high:.4g} {position.unit} "
            f"({whence}); {free:.0f} % of it is kept free."
        )
    return sentences


def _speed(plant: Plant, excitation: Excitation) -> list[str]:
    joints, sentences = len(excitation.hold), []
    for j in range(joints):
        low, high = excitation.bounds.whole()[joints + j]
        of = f"The speed of {plant.joint_name(j)}"
        if excitation.bounds.sources[joints + j] == UNBOUNDED:
            sentences.append(
                f"{of} is not bounded: none is recorded or declared; --speed bounds it."
            )
        else:
            whence = SPEED_WHENCE[excitation.bounds.sources[joints + j]]
            sentences.append(
                f"{of} stays between {low:.4g} and {high:.4g} {_position(plant, j).unit}/s "
                f"({whence})."
            )
    return sentences


def _command(plant: Plant, excitation: Excitation) -> list[str]:
    sentences = []
    for channel in plant.layout.commands:
        j = plant.joint_of(channel)
        low, high = excitation.command[:, j].min(), excitation.command[:, j].max()
        whence = RATE_WHENCE[excitation.bounds.rate_sources[j]]
        sentences.append(
            f"The command {channel.name} goes from {low:.4g} to {high:.4g} {channel.unit} "
            "and changes by at most "
            f"{excitation.bounds.rate[j]:.4g} {channel.unit}/s ({whence})."
        )
    return sentences


def _end(plant: Plant, excitation: Excitation) -> str:
    speeds = ", ".join(
        f"{x:.2g} {_position(plant, j).unit}/s" for j, x in enumerate(excitation.speed_at_end)
    )
    if excitation.rests:
        part = 100 * float(
            (excitation.speed_at_end / np.maximum(excitation.largest_speed, LEAST)).max()
        )
        models = f"every one of {len(excitation.paths)} models"
        return (
            f"It ends at rest under {models}: none is faster than {speeds}, {part:.1f} % of "
            "the largest speed."
        )
    return (
        f"It does NOT end at rest: under one of {len(excitation.paths)} models the machine still "
        f"moves at {speeds}. Be ready to stop it."
    )


def _models(diagnosed: bool) -> str:
    left, guessed = (
        "those that the diagnosis left",
        "the nominal numbers and a spread about them, which no diagnosis has confirmed",
    )
    return (
        f"The models are {left if diagnosed else guessed}. A stop, an obstacle or a load "
        "that is in none of them is not covered: keep a hand on an emergency stop that works "
        "independently of this command."
    )


def _position(plant: Plant, joint: int) -> Channel:
    """The channel that observes a joint's position."""
    return next(
        c
        for c, column in zip(plant.layout.observations, plant.state_columns, strict=True)
        if column == joint
    )
