"""Page: how values become an answer for a browser, and how what a browser sends is read.

Forms work without a script; a script only saves reloading. What an answer may load is its own
server's files, nothing else.
"""

from __future__ import annotations

from typing import Any
from urllib.parse import parse_qs, quote, urlencode

from fastapi import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

from trueup_pages.rendering import render
from trueup_service.authentication import Principal
from trueup_service.errors import TooLargeUpload
from trueup_service.registry.records import Role

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; "
    "connect-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    # without any, a browser would not say that a form comes from a page of ours
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-store",
}
FORM_BYTES = 64 << 10
SIGN_IN = "/sign-in"
SEE_OTHER = 303


def show(request: Request, template: str, status: int = 200, **values: Any) -> HTMLResponse:
    """A page, with who is looking at it."""
    principal: Principal | None = request.scope.get("principal")
    here = {
        "who": principal,
        "path": request.url.path,
        "status": int(status),
        "may": lambda *roles: may(principal, *roles),
    }
    return HTMLResponse(render(template, **here, **values), status, headers=HEADERS)


def may(principal: Principal | None, *roles: str) -> bool:
    """Whether somebody may do what takes one of these roles, as an admin may everything."""
    return principal is not None and bool(principal.roles & {Role.ADMIN, *map(Role, roles)})


def go(path: str, **query: str) -> Response:
    """Send a browser on, after something was done."""
    return RedirectResponse(
        path + (f"?{urlencode(query)}" if query else ""), SEE_OTHER, headers=HEADERS
    )


def wants_page(request: Request) -> bool:
    """Whether a browser asks for something to look at."""
    return not request.url.path.startswith("/v1/") and "text/html" in request.headers.get(
        "accept", ""
    )


def to_sign_in(request: Request) -> Response:
    """Send a browser to sign in, and back to where it was."""
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
