"""Routes of operations: health, readiness, metrics."""

from __future__ import annotations

import os
import shutil
import uuid

from fastapi import Request, Response
from prometheus_client import (
    CONTENT_TYPE_LATEST,
    REGISTRY,
    CollectorRegistry,
    generate_latest,
)
from prometheus_client.multiprocess import MultiProcessCollector
from sqlalchemy.exc import SQLAlchemyError

from trueup import __version__
from trueup_service.errors import LogRewound
from trueup_service.http.dependencies import RequestParts
from trueup_service.http.guard import guarded
from trueup_service.http.registry_metrics import RegistryMetrics
from trueup_service.http.request_telemetry import SHARED_METRICS
from trueup_service.http.schemas.wire import Health, Readiness
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

LEAST_ROOM_BYTES = 64 << 20
router = guarded("", ["operations"])


@router.get("/healthz", summary="The process answers")
async def health() -> Health:
    return Health(status="ok", version=__version__)


@router.get("/readyz", summary="The service can do its work", responses={503: {"model": Readiness}})
def ready(request: Request, parts: RequestParts, response: Response) -> Readiness:
    checks = {
        "database": _database(parts),
        "blobs": _blobs(parts),
        "spool": _spool(parts),
        "log": _log(request),
    }
    is_ready = all(result == "ok" for result in checks.values())
    response.status_code = 200 if is_ready else 503
    return Readiness(ready=is_ready, checks=checks)


def _database(parts: Parts) -> str:
    try:
        with reading(parts.database) as tx:
            tx.log.tree()
    except SQLAlchemyError as error:
        return f"fails: {type(error).__name__}"
    return "ok"


def _log(request: Request) -> str:
    try:
        request.app.state.log.checkpoint()
    except LogRewound as error:
        return f"fails: {error.message}"
    except (SQLAlchemyError, OSError) as error:
        return f"fails: {type(error).__name__}"
    return "ok"


def _blobs(parts: Parts) -> str:
    try:
        parts.blobs.holds("0" * 64)
    except Exception as error:  # noqa: BLE001  (each store raises its own errors, and all of them mean the same here)
        return f"fails: {type(error).__name__}"
    return "ok"


def _spool(parts: Parts) -> str:
    """The check of the disk that takes uploads and, with embedded storage, everything."""
    path = parts.spool / f"ready-{uuid.uuid4().hex}"
    try:
        with path.open("wb") as file:
            file.write(b"ready")
            os.fsync(file.fileno())
        path.unlink()
        room = shutil.disk_usage(parts.spool).free
    except OSError as error:
        return f"cannot be written to: {os.strerror(error.errno or 0)}"
    return "ok" if room >= LEAST_ROOM_BYTES else f"only {room >> 20} MiB are free"


@router.get("/metrics", summary="Prometheus metrics", response_class=Response)
def metrics(parts: RequestParts) -> Response:
    """Of requests: of all server processes that share a socket. Of the registry: as a whole."""
    registry = REGISTRY
    if SHARED_METRICS in os.environ:
        registry = CollectorRegistry()
        MultiProcessCollector(registry)  # type: ignore[no-untyped-call]
    of_registry = CollectorRegistry()
    of_registry.register(RegistryMetrics(parts))
    text = generate_latest(registry) + generate_latest(of_registry)
    return Response(text, media_type=CONTENT_TYPE_LATEST)
