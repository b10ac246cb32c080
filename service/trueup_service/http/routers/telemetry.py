"""Telemetry: live batches of samples, each an episode that is watched and nothing else."""

from __future__ import annotations

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup_service.http.context import By, IdempotencyKey, PlantName, With
from trueup_service.http.guard import guarded
from trueup_service.http.ingesting import against, ingest, inspect
from trueup_service.http.openapi import there
from trueup_service.http.schemas import Episode
from trueup_service.http.uploads import Received, received
from trueup_service.inspection import as_mcap

router = guarded("/v1/plants/{plant}/telemetry", ["episodes"])
NUMBERS = {"type": "array", "items": {"type": "number"}, "minItems": 2}
BATCH = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {
                    "type": "object",
                    "required": ["start_ns", "t_s", "observations", "commands"],
                    "additionalProperties": False,
                    "properties": {
                        "start_ns": {
                            "type": "string",
                            "pattern": "^[0-9]{1,19}$",
                            "description": "ns since 1970, as text",
                        },
                        "t_s": {**NUMBERS, "description": "seconds from start_ns, increasing"},
                        "observations": {"type": "object", "additionalProperties": NUMBERS},
                        "commands": {"type": "object", "additionalProperties": NUMBERS},
                        "conditions": {
                            "type": "object",
                            "additionalProperties": {"type": "string"},
                        },
                        "role": {"enum": ["telemetry", "reference"], "default": "telemetry"},
                    },
                }
            }
        },
    }
}


@router.post(
    "",
    status_code=201,
    response_model=Episode,
    summary="Send a batch of samples",
    responses=there(Episode),
    openapi_extra=BATCH,
)
async def send(
    request: Request, parts: With, context: By, plant: PlantName, key: IdempotencyKey = None
) -> Response:
    """The batch becomes an episode of the role telemetry, or reference: durable once answered, and
    shown to the plant's monitor.

    Residuals begin anew with each batch, so a batch should be several horizons long. The same batch
    again is the same episode.
    """
    held = await run_in_threadpool(against, parts, plant)
    async with received(request, parts.spool, parts.settings.upload_limit_bytes) as file:
        path = as_mcap(file.path)
        try:
            inspected = await inspect(request, file.path, held, telemetry=True)
            episode = Received(path, inspected.digest, path.stat().st_size)
            return await run_in_threadpool(ingest, parts, context, plant, key, episode, inspected)
        finally:
            path.unlink(missing_ok=True)
