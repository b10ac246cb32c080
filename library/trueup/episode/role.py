"""Roles of episodes: an episode may be used only for what it was recorded for."""

from __future__ import annotations

from enum import StrEnum


class Role(StrEnum):
    """What an episode may be used for."""

    TRAINING = "training"
    ADAPTATION = "adaptation"
    VALIDATION = "validation"
    TEST = "test"
    REFERENCE = "reference"
    RETAINED = "retained"
    TELEMETRY = "telemetry"  # a live batch: watched, and never fitted or judged on


STAGES = (
    "MIL",
    "SIL",
    "PIL",
    "HIL",
    "physical",
)  # of the test ladder: model, software, processor, hardware in the loop, and the machine
HELD_OUT = (Role.VALIDATION, Role.RETAINED)  # what a gate judges on
WATCHED = (
    Role.ADAPTATION,
    Role.VALIDATION,
    Role.REFERENCE,
    Role.RETAINED,
    Role.TELEMETRY,
)  # test episodes are for reports alone
HEALTHY = (
    Role.REFERENCE,
    Role.VALIDATION,
    Role.RETAINED,
    Role.TELEMETRY,
)  # what a model was not fitted on may say what is healthy
