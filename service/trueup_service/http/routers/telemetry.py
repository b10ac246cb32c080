"""The route of telemetry: live batches of samples, each an episode that is only watched."""

from __future__ import annotations

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup_service.actions.ingestion import ReceivedFile, plant_context
from trueup_service.http.dependencies import (
    IdempotencyKey,
    PlantName,
    RequestContext,
    RequestParts,
    inspector_of,
)
from trueup_service.http.guard import guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.episodes import Episode
from trueup_service.http.uploads import ingest_response, received
from trueup_service.inspection import mcap_path

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
                        "applied": {
                            "type": "object",
                            "additionalProperties": NUMBERS,
                            "description": "what the drive applied of the commands",
                        },
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
    responses=already_exists(Episode),
    openapi_extra=BATCH,
)
async def send(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    key: IdempotencyKey = None,
) -> Response:
    """The batch becomes an episode of the role telemetry or reference. It is durable once answered,
    and shown to the plant's monitor.

    Residuals begin anew with each batch, so a batch should be several horizons long. The same batch
    again is the same episode.
    """
    against = await run_in_threadpool(plant_context, parts, plant)
    async with received(request, parts.spool, parts.settings.upload_limit_bytes) as file:
        path = mcap_path(file.path)
        try:
            inspected = await inspector_of(request).inspect(file.path, against, telemetry=True)
            episode = ReceivedFile(path, inspected.digest, path.stat().st_size)
            return await run_in_threadpool(
                ingest_response, parts, context, plant, key, episode, inspected
            )
        finally:
            path.unlink(missing_ok=True)
