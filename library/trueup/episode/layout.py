"""The channels of an episode, and the messages of a recording that carry them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Field(StrEnum):
    """The JointState array in which a channel stands."""

    POSITION = "position"
    VELOCITY = "velocity"
    EFFORT = "effort"


class Hold(StrEnum):
    """What a command does between its samples."""

    ZERO_ORDER = "zero_order"  # it keeps its value until the next one
    FIRST_ORDER = "first_order"  # it is a ramp, as a sampled analogue signal


@dataclass(frozen=True, slots=True)
class Channel:
    """One number per sample.

    `joint` is the JointState name, None for the first joint. `scale` is the declared reporting
    scale of an observation: that many units of it are 1 in the dimensionless error norm. `limits`
    bound a command; `hold` is what it does between its samples, None where nobody declared it.
    """

    name: str
    unit: str
    field: Field
    joint: str | None = None
    scale: float = 1.0
    limits: tuple[float, float] | None = None
    hold: Hold | None = None


@dataclass(frozen=True, slots=True)
class Layout:
    """Topics and channels of an episode, as its plant declares them. Commands are issued on the
    command topic; what the drive applied of them may stand on another, in the same fields."""

    observations: tuple[Channel, ...]
    commands: tuple[Channel, ...]
    observation_topic: str = "/joint_states"
    command_topic: str = "/joint_commands"
    applied_topic: str = "/joint_commands/applied"  # a recording may lack it

    @property
    def efforts(self) -> tuple[Channel, ...]:
        """The channels of measured efforts, one for each command; a recording may hold them on the
        observation topic."""
        return tuple(
            Channel(f"effort of {c.name}", "", Field.EFFORT, c.joint) for c in self.commands
        )
