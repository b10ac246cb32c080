"""Operation: which of four kinds of work a job or an entry of the log is.

Monitoring changes nothing. Parameter identification fits the numbers of an unchanged model form;
model correction changes the form, or which model serves. Policy adaptation would change the
controller: nothing here does, and a log that holds one was not written by this service.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from trueup.canonical import Json


class Operation(StrEnum):
    """What is done, and to what."""

    MONITORING = "monitoring"
    IDENTIFICATION = "parameter identification"
    CORRECTION = "model correction"
    ADAPTATION = "policy adaptation"


JOBS: Mapping[str, Operation] = {
    "fit": Operation.CORRECTION,
    "diagnose": Operation.CORRECTION,
    "gate": Operation.CORRECTION,
    "calibrate": Operation.MONITORING,
    "watch": Operation.MONITORING,
    "validate": Operation.MONITORING,
    "blindtrial": Operation.MONITORING,
    "recompute": Operation.MONITORING,
    "compare": Operation.MONITORING,
    "openloop": Operation.MONITORING,
    "closedloop": Operation.MONITORING,
    "consistency": Operation.MONITORING,
    "randomise": Operation.CORRECTION,
    "excite": Operation.MONITORING,
}


def of_job(kind: str, request: Mapping[str, Json]) -> Operation:
    """A job's operation. A fit that keeps the model form is an identification."""
    return Operation.IDENTIFICATION if request.get("method") == "identify" else JOBS[kind]


def of_artifact(kind: str, model: Json) -> Operation | None:
    """The operation that made an artifact, by whether its model has another form or other numbers
    alone; None where it is the nominal model."""
    if kind == "nominal":
        return None
    from trueup.model.effect import effects  # noqa: PLC0415  (numpy: a server that only serves needs none)

    # An effect that is counted in samples is the sensor's, and no part of the form.
    form = [e for e in _effects(model) if not effects()[e].counted]
    same_form = kind == "identified" or (kind == "corrected" and not form)
    return Operation.IDENTIFICATION if same_form else Operation.CORRECTION


def _effects(model: Json) -> list[str]:
    entries: Any = model.get("effects", []) if isinstance(model, Mapping) else []
    return [str(entry["effect"]) for entry in entries]
