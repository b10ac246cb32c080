"""How pages are rendered, and how forms are read.

Forms work without a script, which only saves reloading. A page loads files of its own server only.
"""

from __future__ import annotations

import uuid
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, TypeVar
from urllib.parse import parse_qs, quote, urlencode

from fastapi import APIRouter, Depends, Request
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.responses import HTMLResponse, RedirectResponse, Response

from trueup.canonical import Json
from trueup.errors import TrueupError
from trueup_pages.rendering import render
from trueup_service.actions.submission import Submission
from trueup_service.actions.submit_job import SUBMIT
from trueup_service.actor_context import ActorContext
from trueup_service.authentication import Principal
from trueup_service.control_characters import control_character
from trueup_service.errors import BadRequest, TooLargeUpload
from trueup_service.http.guard import guarded
from trueup_service.http.statuses import status_of
from trueup_service.registry.records import Role
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts

T = TypeVar("T")
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; "
    "connect-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    # without a referrer policy a browser would not send the origin of a form
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-store",
}
FORM_BYTES = 64 << 10
SIGN_IN = "/sign-in"
SEE_OTHER = 303
NOT_A_NUMBER = -1


def begin_job(
    parts: Parts, context: ActorContext, plant: str, kind: str, request: dict[str, Json]
) -> str:
    """Submit a job that a page asks for, and return its id."""
    job = uuid.uuid4().hex
    parts.queue.prepare()
    with writing(parts.database) as tx:
        SUBMIT[kind](Submission(tx, parts.queue, job, plant, request, context))
    return job


def _note_log(request: Request) -> None:
    """Note how long the log is before a page reads what it shows, so that the page hears of every
    entry that it may not show."""
    if request.method == "GET" and "principal" in request.scope and wants_page(request):
        with reading(request.app.state.parts.database) as tx:
            request.state.log_size = tx.log.size()


def page_router() -> APIRouter:
    """A guarded router of pages."""
    return guarded("", ["pages"], documented=False, dependencies=[Depends(_note_log)])


def show(
    request: Request,
    template: str,
    status: int = 200,
    *,
    refused: TrueupError | None = None,
    **values: Any,
) -> HTMLResponse:
    """A rendered page, with who is signed in. Where what its form asked for was `refused`, the
    page says why, and has the status of that."""
    status = status if refused is None else status_of(refused)
    principal: Principal | None = request.scope.get("principal")
    here = {
        "who": principal,
        "path": request.url.path,
        "log_size": getattr(request.state, "log_size", None),
        "status": int(status),
        "may": lambda *roles: may(principal, *roles),
    }
    page = render(template, **here, refused=refused, **values)
    return HTMLResponse(page, status, headers=HEADERS)


def may(principal: Principal | None, *roles: str) -> bool:
    """Whether somebody has one of these roles, or is an admin."""
    return principal is not None and bool(principal.roles & {Role.ADMIN, *map(Role, roles)})


def go(path: str, **query: str) -> Response:
    """Redirect a browser after something was done."""
    return RedirectResponse(
        path + (f"?{urlencode(query)}" if query else ""), SEE_OTHER, headers=HEADERS
    )


async def act(
    request: Request,
    action: Callable[[], Awaitable[object]],
    page: Callable[[TrueupError], Response],
    to: str,
) -> Response:
    """Do what a form asks for, and go to a page; where it is refused, show the page that says so.
    Raises what the action raises, where the caller wants no page."""
    try:
        await action()
    except TrueupError as error:
        if not wants_page(request):
            raise
        return await run_in_threadpool(page, error)
    return go(to)


def checked(validate: Callable[[Any], T], values: Mapping[str, Any]) -> T:
    """What pydantic makes of a form's values. Raises BadRequest, which names the first bad
    field."""
    try:
        return validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"] if part in values) or "form"
        raise BadRequest(
            f"{field}: {first['msg'].lower()}", hint="Correct this field.", field=field
        ) from error


def whole_number(text: str) -> int:
    """A number that a form holds; NOT_A_NUMBER where it is none."""
    text = text.strip()
    short = text.isascii() and text.isdigit() and len(text) < 10  # noqa: PLR2004
    return int(text) if short else NOT_A_NUMBER


def own_path(to: str) -> str:
    """A path that a browser wanted, never one that leads to another site."""
    is_own = to.startswith("/") and not to.startswith(("//", "/\\"))
    return to if is_own and control_character(to) is None else "/"


def wants_page(request: Request) -> bool:
    """Whether the request comes from a browser that wants a page."""
    return not request.url.path.startswith("/v1/") and "text/html" in request.headers.get(
        "accept", ""
    )


def to_sign_in(request: Request) -> Response:
    """Redirect a browser to the sign-in page, and from there back to where it was."""
    query = f"?{request.url.query}" if request.url.query else ""
    return (
        go(SIGN_IN, next=quote(request.url.path) + query)
        if request.method == "GET"
        else go(SIGN_IN)
    )


async def form(request: Request) -> dict[str, str]:
    """The fields of a form, the last of each name. Raises TooLargeUpload."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > FORM_BYTES:
            raise TooLargeUpload("a form holds 64 KiB at most", limit_bytes=FORM_BYTES)
    return {
        name: values[-1]
        for name, values in parse_qs(body.decode(errors="replace"), keep_blank_values=True).items()
    }
