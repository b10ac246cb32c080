"""Telemetry of requests: an id, metrics, a span where traces are exported, and one line of JSON in
the log.

Fleets poll: a read that succeeds is logged at DEBUG only, and a read begins no trace, but stands in
that of its caller.
"""

from __future__ import annotations

import itertools
import logging
import re
import secrets
import time

from prometheus_client import Counter, Histogram
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from trueup_service import open_telemetry
from trueup_service.http.headers import header

log = logging.getLogger("trueup.access")
REQUESTS = Counter("trueup_http_requests_total", "Requests answered", ["method", "route", "status"])
SECONDS = Histogram(
    "trueup_http_request_seconds",
    "Time to answer [s]",
    ["method", "route"],
    buckets=(0.0005, 0.001, 0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1, 5, 30),
)
# The environment variable by which several server processes of one machine share their metrics.
SHARED_METRICS = "PROMETHEUS_MULTIPROC_DIR"
FIRST_ERROR_STATUS = 400
# A response is data: nothing in it may run, or be shown inside another site. A page sets its own
# policy.
FOR_BROWSERS = (
    (
        b"content-security-policy",
        b"default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
)
PLAIN_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")


class RequestTelemetry:
    """ASGI middleware. It takes over the caller's `X-Request-Id` where that is a plain one, and
    responds with the id."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._measures: dict[tuple[str, str, int], tuple[Counter, Histogram]] = {}
        self._ids = (f"{secrets.token_hex(4)}-{n}" for n in itertools.count(1))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = header(scope, b"x-request-id")
        name = given.decode() if PLAIN_ID.fullmatch(given) else next(self._ids)
        scope["request_id"] = name
        if not open_telemetry.is_on():
            await self._answered(scope, receive, send, name)
            return
        trace = header(scope, b"traceparent").decode("latin-1")
        if trace or scope["method"] != "GET":
            await self._traced(scope, receive, send, name, trace)
        else:
            await self._answered(scope, receive, send, name)

    async def _traced(
        self, scope: Scope, receive: Receive, send: Send, name: str, trace: str
    ) -> None:
        with open_telemetry.server_span(scope["method"], trace) as span:
            span.set_attribute("url.path", scope["path"])
            span.set_attribute("trueup.request.id", name)
            status = await self._answered(scope, receive, send, name)
            span.set_attribute("http.response.status_code", status)
            route = _route(scope)
            span.set_attribute("http.route", route)
            span.update_name(f"{scope['method']} {route}")

    async def _answered(self, scope: Scope, receive: Receive, send: Send, name: str) -> int:
        began, status = time.perf_counter(), 500

        async def answer(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                present = {k for k, _ in message["headers"]}
                more = [(k, v) for k, v in FOR_BROWSERS if k not in present]
                message["headers"] = [*message["headers"], (b"x-request-id", name.encode()), *more]
            await send(message)

        try:
            await self._app(scope, receive, answer)
        finally:
            self._note(scope, name, status, time.perf_counter() - began)
        return status

    def _note(self, scope: Scope, name: str, status: int, seconds: float) -> None:
        method, route = scope["method"], _route(scope)
        measures = self._measures.get((method, route, status))
        if measures is None:
            measures = self._measures[method, route, status] = (
                REQUESTS.labels(method, route, status),
                SECONDS.labels(method, route),
            )
        measures[0].inc()
        measures[1].observe(seconds)
        open_telemetry.observe(
            "http.server.request.duration",
            "Time to answer",
            seconds,
            {
                "http.request.method": method,
                "http.route": route,
                "http.response.status_code": status,
            },
        )
        level = logging.DEBUG if method == "GET" and status < FIRST_ERROR_STATUS else logging.INFO
        if log.isEnabledFor(level):
            fields = {
                "request_id": name,
                "method": method,
                "path": scope["path"],
                "status": status,
                "seconds": round(seconds, 6),
            }
            log.log(level, "request", extra=fields)


def _route(scope: Scope) -> str:
    return str(getattr(scope.get("route"), "path", "none"))
