"""Jobs and requests for jobs on the wire."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, computed_field

from trueup.ledger.operation import Operation, of_job
from trueup_service.http.schemas.wire import Digest, FromRecord, RequestBody, Time

Versions = Annotated[list[Digest], Field(min_length=1, max_length=8)]


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


class QueuedJob(Job):
    """A job that has not ended: the worker that runs it and since when, how many jobs were
    submitted before it and have not ended, and how long it still waits and such jobs take, about
    [s]; null where nothing is known of such jobs."""

    worker: str | None
    begun_at: Time | None
    ahead: int
    waits_s: float | None
    takes_s: float | None


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


Finite = Annotated[float, Field(allow_inf_nan=False)]


class Context(RequestBody):
    """The parameters that a conditioned predictor is fed: identified from adaptation episodes,
    configured as plant.json declares, or measured, with the values by name."""

    by: Literal["identification", "configuration", "measurement"] = "identification"
    parameters: dict[str, Finite] | None = Field(
        None, description="measurement only; a parameter that is left out is nominal"
    )


class FitRequest(RequestBody):
    """Fit a candidate. `episodes` are digests of adaptation episodes, null for all of them.

    `blind` and `conditioned` fit a map of the whole family from `training` episodes, one of each
    plant, null for all of them.
    """

    kind: Literal["fit"]
    method: Literal["identify", "residual", "blind", "conditioned"]
    episodes: list[Digest] | None = None
    training: list[Digest] | None = Field(None, description="blind and conditioned only")
    context: Context | None = Field(
        None, description="conditioned only; null for identification from adaptation episodes"
    )
    randomisation: dict[str, Any] | None = Field(
        None,
        description="blind and conditioned only: the family that training plants were drawn from, "
        "whose box is then kept with the model",
    )
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


class OpenloopRequest(RequestBody):
    """Roll versions out on commands alone, and compare their errors after some numbers of steps
    with a bound on them.

    `versions` are digests, null for the nominal model and what serves. `machine` is the version
    that stands in for the true step, null for the newest diagnosis, else the newest identification.
    `episodes` are null for all of the role test, and where there is none for all held-out ones.
    """

    kind: Literal["openloop"]
    versions: Versions | None = None
    machine: Digest | None = None
    episodes: list[Digest] | None = None
    horizons_steps: list[Annotated[int, Field(ge=1, le=100_000)]] = Field(
        [1, 10, 50, 200], min_length=1, max_length=16, description="declared steps"
    )


class Reference(RequestBody):
    """A sine wave about zero that a single joint is asked to follow."""

    amplitude: float = Field(gt=0, allow_inf_nan=False, description="in the position's unit")
    frequency_hz: float = Field(gt=0, allow_inf_nan=False)


class ClosedloopRequest(RequestBody):
    """Run versions in closed loop with a fixed planner, in up to four regimes, on what stands in
    for the machine.

    `versions` are digests, null for the nominal model and what serves; changes are told against the
    first. `machine` is the version that stands in for the machine, null for the newest diagnosis,
    else the newest identification, else the nominal model. `episodes` are adaptation episodes that
    say how far the machine travels, null for all of them.
    """

    kind: Literal["closedloop"]
    versions: Versions | None = None
    machine: Digest | None = None
    episodes: list[Digest] | None = None
    regimes: list[Literal["nominal", "shifted", "delayed", "reduced_authority"]] = Field(
        ["nominal", "shifted", "delayed", "reduced_authority"], min_length=1, max_length=4
    )
    seeds: list[Annotated[int, Field(ge=0, lt=2**32)]] = Field(
        [0, 1, 2, 3], min_length=1, max_length=64, description="one run of each reference each"
    )
    delay_ticks: int = Field(3, ge=0, le=1000, description="of the delayed regime's sensor")
    authority: float = Field(
        0.5, gt=0, le=1, description="share of each command's range in the reduced regime"
    )
    sweep_ticks: list[Annotated[int, Field(ge=0, le=1000)]] = Field(
        [],
        max_length=16,
        description="sensor delays to sweep, each with and without stamps on what is observed",
    )
    reference: Reference | None = Field(
        None, description="null for three waves within the envelope or the recorded travel"
    )
    ticks: int = Field(200, ge=10, le=5000, description="of the controller in each run")
    effort: float | None = Field(
        None,
        ge=0,
        allow_inf_nan=False,
        description="single joint only: cost of a squared command, in squares of the position",
    )


class ConsistencyRequest(RequestBody):
    """Tell whether recordings agree on the numbers of a version: each recording, day and condition
    alone.

    `version` is a digest, null for the newest diagnosis, else the newest identification, else the
    nominal model. `episodes` are null for all adaptation and validation episodes. With `diagnoses`
    days, conditions or halves of them are diagnosed from the start, too.
    """

    kind: Literal["consistency"]
    version: Digest | None = None
    episodes: list[Digest] | None = None
    diagnoses: bool = False


class RandomisationRequest(RequestBody):
    """Draw plants from a family, simulate them, and fit the parameter-blind and the conditioned
    predictor, which become candidates.

    `randomisation` is the family, schema `trueup.randomisation/1`; null for the ranges that
    `diagnosis`, the id of a job, supports, by default the newest. `episodes` are adaptation
    episodes of the deployment plant, null for all of them.
    """

    kind: Literal["randomise"]
    randomisation: dict[str, Any] | None = None
    diagnosis: str | None = Field(None, pattern=r"^[0-9a-f]{32}$")
    episodes: list[Digest] | None = None
    context: Context | None = Field(
        None, description="null for identification from the adaptation episodes"
    )
    plants: int = Field(24, ge=1, le=5000)
    steps: int = Field(160, ge=2, le=100_000, description="simulated of each plant")
    seed: int = Field(0, ge=0, lt=2**32)
    start_scale: float = Field(
        0.4,
        ge=0,
        allow_inf_nan=False,
        description="standard deviation of the starts, in reporting scales",
    )


class ExcitationRequest(RequestBody):
    """Design a bounded excitation: a command that identifies the numbers of a model best, or that
    separates the explanations which a diagnosis left, and is safe under every model in play.

    `diagnosis` is the id of a job, null for the newest. `spread`, or no diagnosis at all, designs
    for the declared model instead. `episodes` are the adaptation episodes whose ranges bound the
    command, null for all of them.
    """

    kind: Literal["excite"]
    goal: Literal["identify", "split"] = "identify"
    diagnosis: str | None = Field(None, pattern=r"^[0-9a-f]{32}$")
    spread: float | None = Field(
        None,
        gt=0,
        le=1,
        allow_inf_nan=False,
        description="of the declared model: relative 95 % interval of each number; 0.3 where "
        "nothing has been diagnosed",
    )
    episodes: list[Digest] | None = None
    duration_s: float = Field(
        12.0, gt=0, le=3600, allow_inf_nan=False, description="without the hold at its end [s]"
    )
    band_hz: tuple[Finite, Finite] | None = Field(
        None,
        description="lowest and highest frequency [Hz]; null: by the duration and the time step",
    )
    rate: float | None = Field(
        None,
        gt=0,
        allow_inf_nan=False,
        description="largest change of a command [its unit / s]; null: as recorded",
    )
    speed: float | None = Field(
        None,
        gt=0,
        allow_inf_nan=False,
        description="largest speed of a joint [its unit / s]; null: as recorded",
    )
    margin: float = Field(
        0.1, ge=0, lt=1, allow_inf_nan=False, description="share of the envelope that is kept free"
    )
    seed: int = Field(0, ge=0, lt=2**32)


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
