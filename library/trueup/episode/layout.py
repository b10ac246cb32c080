"""The channels of an episode, and the messages of a recording that carry them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Field(StrEnum):
    """The JointState array in which a channel stands."""

    POSITION = "position"
    VELOCITY = "velocity"
    EFFORT = "effort"


@dataclass(frozen=True, slots=True)
class Channel:
    """One number per sample.

    `joint` is the JointState name, None for the first joint. `scale` is the declared reporting
    scale of an observation: that many units of it are 1 in the dimensionless error norm. `limits`
    bound a command.
    """

    name: str
    unit: str
    field: Field
    joint: str | None = None
    scale: float = 1.0
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Layout:
    """Topics and channels of an episode, as its plant declares them. Commands are issued on the
    command topic; what the drive applied of them may stand on another, in the same fields."""

    observations: tuple[Channel, ...]
    commands: tuple[Channel, ...]
    observation_topic: str = "/joint_states"
    command_topic: str = "/joint_commands"
    applied_topic: str = "/joint_commands/applied"  # a recording may lack it
