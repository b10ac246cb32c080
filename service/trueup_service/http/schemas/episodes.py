"""Plants and their episodes on the wire."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from trueup_service.http.schemas.serving import Serving
from trueup_service.http.schemas.wire import Digest, FromRecord, Time


class Plant(FromRecord):
    """A registered plant with its description."""

    name: str
    digest: Digest
    document: dict[str, Any]
    created_at: Time
    created_by: str
    project: str | None


class Episode(FromRecord):
    """An ingested episode."""

    plant: str
    digest: Digest
    size_bytes: int
    role: str
    summary: dict[str, Any]
    created_at: Time
    created_by: str


class EpisodeContext(Episode):
    """An episode with what was serving while it was recorded, and how many jobs of each kind have
    read it."""

    served: list[Serving]
    uses: dict[str, int]


class Upload(BaseModel):
    """An upload in parts, and how many of its bytes are durable."""

    digest: Digest
    offset_bytes: int
