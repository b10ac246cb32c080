"""Drafts of plants on the wire."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from trueup_service.http.schemas.decisions import Gate
from trueup_service.http.schemas.episodes import Episode, Plant
from trueup_service.http.schemas.jobs import Finite
from trueup_service.http.schemas.wire import Digest, Name, RequestBody

Text = Annotated[str, Field(max_length=255)]


class Wishes(RequestBody):
    """What a person says of received files; what is left out is found. `signals` and `units` are by
    `q`, the position, `v`, the velocity, and `u`, the command, of a single joint. `mapping` says
    which signals are meant of a robot, and `plant` is a plant.json in place of the found one."""

    name: Name | None = None
    family: Literal["inertia", "pendulum", "oscillator"] | None = None
    stage: Literal["MIL", "SIL", "PIL", "HIL", "physical"] = "physical"
    joint: Text | None = None
    signals: dict[Literal["q", "v", "u"], Text] = Field(default_factory=dict)
    units: dict[Literal["q", "v", "u"], Text] = Field(default_factory=dict)
    time: Text | None = Field(None, description="column of a table that holds the time")
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    rate_hz: Finite | None = Field(None, gt=0, description="of a table that has no time")
    mapping: Annotated[str, Field(max_length=65536)] | None = Field(
        None, description="a mapping, as JSON"
    )
    plant: dict[str, Any] | None = None


class DraftEpisode(BaseModel):
    """An episode of a draft: the file's name in the draft, and the recording that it is of."""

    file: str
    role: str
    samples: int
    duration_s: float
    recording: str


class Draft(BaseModel):
    """A plant that received files propose, with its episodes. `digest` is the SHA-256 of what was
    received, `unused` the files of it that the draft does not use. Where `plant` is null, `problem`
    says what a person must decide first, and `signals` lists what there is to choose from."""

    digest: Digest
    name: str
    plant: dict[str, Any] | None
    mapping: dict[str, Any] | None
    episodes: list[DraftEpisode]
    findings: list[dict[str, Any]]
    signals: list[str]
    stage: str
    is_role_declared: bool
    unused: list[str]
    problem: dict[str, Any] | None


class DraftRegistration(RequestBody):
    """Register what a draft proposes. With `declare_gate` the default gate is declared, before
    anything is scored."""

    declare_gate: bool = False


class Registered(BaseModel):
    """A plant that was registered from a draft, with its episodes, and its gate if one was
    declared."""

    plant: Plant
    episodes: list[Episode]
    gate: Gate | None
