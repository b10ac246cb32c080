"""The application: its routers, its errors, and the tasks that run as long as it does."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from trueup import __version__
from trueup_service import open_telemetry
from trueup_service.authentication import Authenticator
from trueup_service.expiry import INTERVAL_S, remove_expired
from trueup_service.http import openapi, problems
from trueup_service.http.body_limit import BodyLimit
from trueup_service.http.hosts import AllowedHosts
from trueup_service.http.live import LiveFeed
from trueup_service.http.openid import OpenIdProvider
from trueup_service.http.pages import audit as audit_page
from trueup_service.http.pages import channels as channels_page
from trueup_service.http.pages import compare as compare_page
from trueup_service.http.pages import decision as decision_page
from trueup_service.http.pages import diagnosis as diagnosis_page
from trueup_service.http.pages import episode as episode_page
from trueup_service.http.pages import excite as excite_page
from trueup_service.http.pages import gate as gate_page
from trueup_service.http.pages import jobs as jobs_page
from trueup_service.http.pages import label as label_page
from trueup_service.http.pages import lists as lists_page
from trueup_service.http.pages import live as live_page
from trueup_service.http.pages import monitor as monitor_page
from trueup_service.http.pages import new_plant as new_plant_page
from trueup_service.http.pages import openid as openid_page
from trueup_service.http.pages import plant as plant_page
from trueup_service.http.pages import plants as plants_page
from trueup_service.http.pages import policy as policy_page
from trueup_service.http.pages import session as session_page
from trueup_service.http.pages import study as study_page
from trueup_service.http.pages import upload as upload_page
from trueup_service.http.pages import version as version_page
from trueup_service.http.registry_metrics import export_gauges
from trueup_service.http.request_telemetry import RequestTelemetry
from trueup_service.http.route_index import RouteIndex
from trueup_service.http.routers import (
    access,
    artifacts,
    audit,
    channels,
    decisions,
    drafts,
    episodes,
    families,
    gates,
    jobs,
    labels,
    monitors,
    operations,
    plants,
    policies,
    serving,
    telemetry,
    uploads,
    webhooks,
)
from trueup_service.http.serving_answers import ServingAnswers
from trueup_service.inspection import Inspector
from trueup_service.signed_log import SignedLog, open_log
from trueup_service.wiring import Parts

DESCRIPTION = """Find where a robot's dynamics model is wrong, correct it, and serve the correction
only if it has earned it.

A recorded episode goes in (`POST …/episodes`), a job fits a candidate (`POST …/jobs`), a gate that
was declared before decides, and the serving pointer moves (`POST …/serving/promote`) or goes back
(`POST …/serving/rollback`). Everything done stands in `/v1/audit`.

Errors are `application/problem+json` with a stable `code` and a `hint`. Every POST takes an
`Idempotency-Key`."""


ROUTERS = (
    serving, plants, drafts, episodes, uploads, telemetry, artifacts, families, gates, jobs,
    decisions, monitors, policies, channels, labels, audit, access, webhooks,
    operations,
)  # fmt: skip


PAGES = (
    session_page,
    openid_page,
    plants_page,
    live_page,
    new_plant_page,
    plant_page,
    upload_page,
    jobs_page,
    gate_page,
    excite_page,
    policy_page,
    monitor_page,
    channels_page,
    diagnosis_page,
    decision_page,
    episode_page,
    lists_page,
    version_page,
    label_page,
    compare_page,
    study_page,
    audit_page,
)
log = logging.getLogger("trueup.http")


async def _publish(signed: SignedLog, interval_s: float) -> None:
    """Keep the published head of the log up to date."""
    while True:
        try:
            await run_in_threadpool(signed.publish)
        except Exception:
            log.exception("the log's head could not be published; trying again")
        await asyncio.sleep(interval_s)


async def _remove_expired(parts: Parts) -> None:
    """Remove what was stored for a limited time."""
    while True:
        try:
            await run_in_threadpool(remove_expired, parts)
        except Exception:
            log.exception("what has reached its age could not be removed; trying again")
        await asyncio.sleep(INTERVAL_S)


def create_app(parts: Parts) -> FastAPI:
    """The HTTP application of the service over these parts."""

    @asynccontextmanager
    async def alive(app: FastAPI) -> AsyncIterator[None]:
        export_gauges(parts)
        app.state.answers = ServingAnswers(parts.database, parts.settings.watch_interval_s)
        app.state.live = LiveFeed(parts.database)
        limits = parts.settings.inspection_memory_bytes, parts.settings.inspection_timeout_s
        app.state.inspector = Inspector(parts.settings.inspections, *limits)
        publishing = asyncio.create_task(
            _publish(app.state.log, parts.settings.checkpoint_interval_s)
        )
        tidying = asyncio.create_task(_remove_expired(parts))
        yield
        publishing.cancel()
        tidying.cancel()
        app.state.live.close()
        await run_in_threadpool(open_telemetry.flush)
        app.state.inspector.close()
        parts.close()

    app = FastAPI(
        title="trueup",
        version=__version__,
        description=DESCRIPTION,
        lifespan=alive,
        docs_url=None,
        redoc_url=None,
    )
    app.state.parts = parts
    app.state.authenticator = Authenticator(parts.settings, parts.database)
    app.state.log = open_log(parts.settings, parts.database)
    app.state.openid = (
        OpenIdProvider(parts.settings) if parts.settings.openid_issuer is not None else None
    )
    problems.install(app)
    openapi.install(app)
    routes = [route for module in (*ROUTERS, *PAGES) for route in module.router.routes]
    app.router.routes += [RouteIndex(routes), *routes]
    app.add_middleware(BodyLimit, room_bytes=parts.settings.bodies_limit_bytes)
    app.add_middleware(AllowedHosts, settings=parts.settings)
    app.add_middleware(RequestTelemetry)
    return app
