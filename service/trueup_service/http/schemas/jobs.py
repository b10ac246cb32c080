"""Jobs and requests for jobs on the wire."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, computed_field

from trueup.ledger.operation import Operation, of_job
from trueup_service.http.schemas.wire import Digest, FromRecord, RequestBody, Time


class Job(FromRecord):
    """A job. `progress` runs from 0 to 1. `result` is the result, or a problem with `code`,
    `detail` and `hint`. `operation` says whether it monitors, identifies parameters or corrects a
    model; nothing here adapts a control policy."""

    id: str
    plant: str
    kind: str
    request: dict[str, Any]
    state: str
    progress: float
    stage: str
    result: dict[str, Any] | None
    created_at: Time
    created_by: str
    updated_at: Time

    @computed_field  # type: ignore[prop-decorator]
    @property
    def operation(self) -> Operation:
        """Whether the job monitors, identifies parameters or corrects a model."""
        return of_job(self.kind, self.request)


class Output(FromRecord):
    """A file that a job left behind."""

    name: str
    digest: Digest
    size_bytes: int
    media_type: str


class JobWithReads(Job):
    """A job, the digests of everything that it has read and for what, and the files that it left
    behind."""

    reads: dict[str, str]
    outputs: list[Output]


class FitRequest(RequestBody):
    """Fit a candidate. `episodes` are digests of adaptation episodes, null for all of them."""

    kind: Literal["fit"]
    method: Literal["identify", "residual"]
    episodes: list[Digest] | None = None
    features: list[str] | None = Field(
        None,
        description="residual only: features of the linear map, such as q, v, u, q*v, sign(v), 1",
    )
    penalty: float | None = Field(
        None, gt=0, allow_inf_nan=False, description="residual only: ridge penalty on every weight"
    )


class GateRequest(RequestBody):
    """Judge `candidate` against what serves now by the gate in force. `episodes` are held-out
    episodes, null for all of them."""

    kind: Literal["gate"]
    candidate: Digest
    gate: Digest
    episodes: list[Digest] | None = None
    scales: bool = Field(
        False, description="Also judge with each channel's reporting scale halved and doubled"
    )


class DiagnosisRequest(RequestBody):
    """Diagnose the gap of the plant's nominal model. `episodes` are adaptation and validation
    episodes, null for all of them."""

    kind: Literal["diagnose"]
    episodes: list[Digest] | None = None
    seed: int = Field(0, ge=0, lt=2**32, description="of the resampling behind the intervals")


class BlindtrialRequest(RequestBody):
    """Hide effects in simulated machines that are made like the plant, diagnose them blindly, and
    report how often that was right."""

    kind: Literal["blindtrial"]
    trials: int = Field(
        60, ge=1, le=2000, description="machines to draw; each takes as long as a diagnosis"
    )
    episodes: list[Digest] | None = None


class ValidationRequest(RequestBody):
    """Compare the error of what serves now on episodes held out since its promotion with its error
    at the promotion."""

    kind: Literal["validate"]


class RecomputationRequest(RequestBody):
    """Recompute a decision from its gate, artifacts and episodes, and report whether the result
    agrees with the recorded decision."""

    kind: Literal["recompute"]
    decision: Digest


class ComparisonRequest(RequestBody):
    """Roll out two versions on the same episodes, null for all held-out ones. For a single episode
    the job leaves an MCAP file with both."""

    kind: Literal["compare"]
    first: Digest
    second: Digest
    episodes: list[Digest] | None = None


class CalibrationRequest(RequestBody):
    """Calibrate a monitor of what serves now. `episodes` are healthy episodes, null for all of the
    role reference."""

    kind: Literal["calibrate"]
    promise_h: float = Field(
        100.0,
        gt=0,
        allow_inf_nan=False,
        description="operating hours in which one false alarm is allowed, of all joints",
    )
    detectors: list[str] | None = Field(
        None,
        description=(
            "which detectors share the promise; null for all that the reference is long enough for"
        ),
    )
    episodes: list[Digest] | None = None
    seed: int = Field(0, ge=0, lt=2**32, description="of the resampling")
