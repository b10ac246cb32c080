"""Roles of data, kept apart: what an episode was recorded for is what it may be used for."""

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
