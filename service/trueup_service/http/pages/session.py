"""The pages to sign in and out, and the files that pages load."""

from __future__ import annotations

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup_pages.assets import by_url, bytes_of, type_of
from trueup_service.errors import NotFound, Unauthenticated
from trueup_service.http.dependencies import RequestParts
from trueup_service.http.guard import require_own_page
from trueup_service.http.pages.page import form, go, own_path, page_router, show
from trueup_service.http.sessions import begin_session, end_session, forget_cookie, give_cookie
from trueup_service.http.statuses import status_of

router = page_router()
FOR_EVER = {"Cache-Control": "public, max-age=31536000, immutable"}


@router.get("/sign-in")
async def sign_in_page(request: Request) -> Response:
    """The form for a token."""
    return _form(request, request.query_params.get("next", "/"))


@router.post("/sign-in")
async def sign_in(request: Request, parts: RequestParts) -> Response:
    """Begin a session with a token, and go on to where the browser wanted to be."""
    require_own_page(request)
    fields = await form(request)
    to = own_path(fields.get("next", "/"))
    try:
        _, secret = await run_in_threadpool(
            begin_session, request.app.state.authenticator, parts, fields.get("token", "").strip()
        )
    except Unauthenticated as error:
        return _form(request, to, error)
    answer = go(to)
    give_cookie(request, answer, parts, secret)
    return answer


def _form(request: Request, to: str, problem: Unauthenticated | None = None) -> Response:
    has_provider = request.app.state.openid is not None
    label = request.app.state.parts.settings.openid_label if has_provider else None
    status = 200 if problem is None else status_of(problem)
    return show(request, "sign_in.html", status, next=to, problem=problem, openid=label)


@router.post("/sign-out")
async def sign_out(request: Request, parts: RequestParts) -> Response:
    """End the session, and go to the sign-in page."""
    await run_in_threadpool(end_session, request, parts)
    answer = go("/sign-in")
    forget_cookie(answer)
    return answer


@router.get("/static/{name}")
async def static(name: str) -> Response:
    """A file, whose name holds its digest."""
    path = by_url().get(name)
    if path is None:
        raise NotFound(f"there is no file {name!r} here", noun="file", name=name)
    return Response(bytes_of(path), media_type=type_of(path), headers=FOR_EVER)
