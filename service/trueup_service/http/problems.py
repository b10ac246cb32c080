"""Errors as problem details (RFC 9457)."""

from __future__ import annotations

import errno
import json
import logging
from http import HTTPStatus

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from sqlalchemy.exc import DataError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from starlette.exceptions import HTTPException

from trueup import errors
from trueup_service import errors as service
from trueup_service.http.pages.page import show, to_sign_in, wants_page
from trueup_service.http.statuses import status_of

log = logging.getLogger("trueup.http")

FULL = (errno.ENOSPC, errno.EDQUOT)
MEDIA_TYPE = "application/problem+json"


def answer(request: Request, error: errors.TrueupError) -> Response:
    """The problem document of an error."""
    response = problem(
        request, status_of(error), error.code, error.message, error.hint, error.facts
    )
    if isinstance(error, service.MemoryFull):
        response.headers["Retry-After"] = "1"
    if isinstance(error, service.Unauthenticated):
        response.headers["WWW-Authenticate"] = 'Bearer realm="trueup"'
    return response


def problem(
    request: Request,
    status: int,
    code: str,
    detail: str,
    hint: str,
    facts: dict[str, object] | None = None,
) -> Response:
    """A problem document (RFC 9457) with a stable `code`, the next step in `hint`, values in
    `facts`, and the id of the request. A browser gets a page of it."""
    if wants_page(request):
        if status == HTTPStatus.UNAUTHORIZED:
            return to_sign_in(request)
        return show(
            request,
            "problem.html",
            status,
            code=code,
            detail=detail,
            hint=hint,
            request_id=request.scope.get("request_id"),
        )
    body = {
        "type": f"urn:trueup:problem:{code}",
        "title": HTTPStatus(status).phrase,
        "status": int(status),
        "detail": detail,
        "code": code,
        "hint": hint,
        "facts": facts or {},
        "request_id": request.scope.get("request_id"),
    }
    return Response(_plain_json(body), status, media_type=MEDIA_TYPE)


def _plain_json(body: dict[str, object]) -> bytes:
    """JSON of whatever text the caller has sent. Text that is not valid Unicode is escaped."""
    try:
        return orjson.dumps(body, default=str)
    except TypeError:
        return json.dumps(body, default=str).encode()


def install(app: FastAPI) -> None:
    """Give every error of the application a handler that responds with a problem document."""

    @app.exception_handler(errors.TrueupError)
    def _ours(request: Request, error: errors.TrueupError) -> Response:
        return answer(request, error)

    @app.exception_handler(RequestValidationError)
    def _invalid(request: Request, error: RequestValidationError) -> Response:
        fields = [
            {"field": ".".join(map(str, e["loc"])), "message": e["msg"]} for e in error.errors()
        ]
        first = fields[0] if fields else {"field": "", "message": "invalid"}
        return problem(
            request,
            HTTPStatus.UNPROCESSABLE_ENTITY,
            "invalid-request",
            f"{first['field']}: {first['message']}",
            "Correct the named fields; /openapi.json shows what each takes.",
            {"fields": fields},
        )

    @app.exception_handler(HTTPException)
    def _plain(request: Request, error: HTTPException) -> Response:
        # An error of ours that occurred while the framework read a body says more.
        if isinstance(error.__cause__, errors.TrueupError):
            return answer(request, error.__cause__)
        code = HTTPStatus(error.status_code).phrase.lower().replace(" ", "-")
        response = problem(
            request,
            error.status_code,
            code,
            str(error.detail),
            "Compare the request with /openapi.json.",
        )
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(OperationalError)
    @app.exception_handler(PoolTimeout)
    def _database(request: Request, error: Exception) -> Response:
        log.error(
            "the database failed",
            exc_info=error,
            extra={"request_id": request.scope.get("request_id")},
        )
        return problem(
            request,
            HTTPStatus.SERVICE_UNAVAILABLE,
            "not-ready",
            "the database cannot be used now",
            "Try again with the same Idempotency-Key; /readyz says what is missing.",
        )

    @app.exception_handler(OSError)
    def _disk(request: Request, error: OSError) -> Response:
        log.error(
            "the disk failed", exc_info=error, extra={"request_id": request.scope.get("request_id")}
        )
        is_full = error.errno in FULL
        return problem(
            request,
            HTTPStatus.INSUFFICIENT_STORAGE if is_full else HTTPStatus.SERVICE_UNAVAILABLE,
            "storage-full" if is_full else "storage-failed",
            "the disk is full" if is_full else "the disk cannot be used now",
            (
                "Nothing was kept. Try again with the same Idempotency-Key once /readyz "
                "says that there is room."
            ),
        )

    @app.exception_handler(DataError)
    def _value(request: Request, error: DataError) -> Response:
        hint = "Compare the request with /openapi.json."
        return problem(
            request,
            HTTPStatus.BAD_REQUEST,
            "bad-request",
            "the database cannot hold a value that was sent",
            hint,
        )

    @app.exception_handler(Exception)
    def _unexpected(request: Request, error: Exception) -> Response:
        log.error(
            "unexpected", exc_info=error, extra={"request_id": request.scope.get("request_id")}
        )
        return problem(
            request,
            HTTPStatus.INTERNAL_SERVER_ERROR,
            "internal",
            "the service failed",
            "Report it with the request id.",
        )
