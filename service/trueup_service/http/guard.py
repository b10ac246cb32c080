"""Access control: every route authenticates its caller before a byte of the body is read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Depends, Request, params
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from trueup_service.actions import find
from trueup_service.authentication import Authenticator, Principal
from trueup_service.errors import Forbidden, NotFound, Unauthenticated
from trueup_service.http.access import ACCESS, Rule
from trueup_service.http.headers import header
from trueup_service.registry.database import Database
from trueup_service.registry.transaction import reading

COOKIE = "trueup_session"
SAFE = ("GET", "HEAD")
NOBODY = Rule()


class Guarded(APIRoute):
    """A route that only an authorised caller reaches."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Authenticate and authorise, then handle the request. Raises Unauthenticated, Forbidden,
        NotFound."""
        if scope["method"] in (self.methods or ()):
            await authorise(Request(scope), self.path)
            await self.answer(scope, receive, send)
        else:
            await super().handle(scope, receive, send)

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer an authorised caller."""
        await super().handle(scope, receive, send)


async def authorise(request: Request, path: str) -> None:
    """Authenticate the caller of a route and check what it may do, before a byte of the body is
    read. Raises Unauthenticated, Forbidden, NotFound."""
    rule = ACCESS.get((request.scope["method"], path), NOBODY)
    if not rule.public:
        principal = request.scope["principal"] = await _authenticate(request)
        _require(principal, rule)
        await _require_plant(request, principal)


def guarded(
    prefix: str,
    tags: list[str],
    *,
    documented: bool = True,
    dependencies: Sequence[params.Depends] = (),
) -> APIRouter:
    """A router whose routes are guarded, and have these dependencies."""
    return APIRouter(
        prefix=prefix,
        tags=list(tags),
        route_class=Guarded,
        include_in_schema=documented,
        dependencies=dependencies,
    )


async def _authenticate(request: Request) -> Principal:
    authenticator: Authenticator = request.app.state.authenticator
    kind, _, token = header(request.scope, b"authorization").decode("latin-1").partition(" ")
    if kind.lower() == "bearer":
        principal = authenticator.remembered(token)
        return (
            principal
            if principal is not None
            else await run_in_threadpool(authenticator.by_token, token)
        )
    cookie = request.cookies.get(COOKIE)
    if cookie is None:
        raise Unauthenticated
    require_own_page(request)
    principal = authenticator.remembered(cookie)
    return (
        principal
        if principal is not None
        else await run_in_threadpool(authenticator.by_session, cookie)
    )


def require_own_page(request: Request) -> None:
    """Refuse a browser's change that does not come from a page of this service, since a browser
    sends its cookie whoever made it ask. Raises Forbidden.

    SameSite=Strict keeps the cookie from requests of other sites. This check also holds against
    other origins of the same site.
    """
    if request.method in SAFE:
        return
    origin = request.headers.get("origin")
    ours = origin_of(request)
    if request.headers.get("sec-fetch-site", "same-origin") != "same-origin" or origin != ours:
        raise Forbidden(
            "the request does not come from a page of this service",
            hint="Programs send a token, not a cookie.",
        )


def origin_of(request: Request) -> str:
    """The scheme and host under which a browser reaches the service, from the settings where there
    is a proxy."""
    public: str | None = request.app.state.parts.settings.public_url
    return (
        public.rstrip("/")
        if public
        else f"{request.url.scheme}://{request.headers.get('host', '')}"
    )


def _require(principal: Principal, rule: Rule) -> None:
    """Raises Forbidden where a rule does not allow the caller."""
    if not principal.roles & rule.roles:
        held, needed = sorted(principal.roles), sorted(rule.roles)
        raise Forbidden(
            f"{principal.name!r} is {' and '.join(held)}; this takes {' or '.join(needed)}",
            roles=needed,
        )
    if rule.everywhere and not principal.everywhere:
        raise Forbidden(
            "this shows all projects, and the token is of one",
            hint="Ask an admin for a token of all projects.",
        )


async def _require_plant(request: Request, principal: Principal) -> None:
    """Raises NotFound for a plant that the token does not see, as for one that does not exist."""
    if principal.everywhere:
        return
    plant = request.path_params.get("plant")
    if plant is None:
        return
    if not await run_in_threadpool(is_visible, request.app.state.parts.database, principal, plant):
        raise find.not_found("plant", plant)


def is_visible(database: Database, principal: Principal, plant: str) -> bool:
    """Whether a token sees a plant."""
    if principal.plant is not None:
        return plant == principal.plant
    if principal.project is None:
        return True
    with reading(database) as tx:
        return tx.plants.is_in_project(plant, principal.project)


async def _principal(request: Request) -> Principal:
    principal: Principal = request.scope["principal"]
    return principal


def require_visible(database: Database, principal: Principal, plant: str, hidden: NotFound) -> None:
    """Raises `hidden`, the error for what does not exist, where the token does not see the plant of
    a thing that was named without it."""
    if not principal.everywhere and not is_visible(database, principal, plant):
        raise hidden


CurrentPrincipal = Annotated[Principal, Depends(_principal)]
