"""Roles of episodes: an episode may be used only for what it was recorded for."""

from __future__ import annotations

from enum import StrEnum

from trueup.errors import NotAnEpisode


class Role(StrEnum):
    """What an episode may be used for."""

    TRAINING = "training"
    ADAPTATION = "adaptation"
    VALIDATION = "validation"
    TEST = "test"
    REFERENCE = "reference"
    RETAINED = "retained"
    TELEMETRY = "telemetry"  # a live batch: watched, and never fitted or judged on


def role_named(name: str) -> Role:
    """The role of this name. Raises NotAnEpisode (rule `role`) where there is none."""
    if name not in set(Role):
        raise NotAnEpisode(f"the role {name!r} is none of {', '.join(Role)}", rule="role")
    return Role(name)


# of the test ladder: model, software, processor, hardware in the loop, and the machine
STAGES = ("MIL", "SIL", "PIL", "HIL", "physical")
HELD_OUT = (Role.VALIDATION, Role.RETAINED)  # what a gate judges on
# test episodes are for reports alone
WATCHED = (Role.ADAPTATION, Role.VALIDATION, Role.REFERENCE, Role.RETAINED, Role.TELEMETRY)
# what a model was not fitted on may say what is healthy
HEALTHY = (Role.REFERENCE, Role.VALIDATION, Role.RETAINED, Role.TELEMETRY)
