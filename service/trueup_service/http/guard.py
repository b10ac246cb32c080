"""The door: every route asks here who comes, before a byte of the body is read."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from trueup_service.actions import find
from trueup_service.authentication import Authenticator, Principal
from trueup_service.errors import Forbidden, NotFound, Unauthenticated
from trueup_service.http.access import ACCESS, Rule
from trueup_service.registry.database import Database
from trueup_service.registry.transaction import reading

COOKIE = "trueup_session"
SAFE = ("GET", "HEAD")
NOBODY = Rule()


class Guarded(APIRoute):
    """A route that whoever may not use it does not reach."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse or go on. Raises Unauthenticated, Forbidden, NotFound."""
        if scope["method"] in (self.methods or ()):
            rule = ACCESS.get((scope["method"], self.path), NOBODY)
            if not rule.public:
                request = Request(scope)
                principal = scope["principal"] = await _recognised(request)
                _require(principal, rule)
                await _require_plant(request, principal)
        await super().handle(scope, receive, send)


def guarded(prefix: str, tags: list[str]) -> APIRouter:
    """A router whose routes are guarded."""
    return APIRouter(prefix=prefix, tags=list(tags), route_class=Guarded)


async def _recognised(request: Request) -> Principal:
    authenticator: Authenticator = request.app.state.authenticator
    kind, _, token = request.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        found = authenticator.remembered(token)
        return (
            found if found is not None else await run_in_threadpool(authenticator.by_token, token)
        )
    cookie = request.cookies.get(COOKIE)
    if cookie is None:
        raise Unauthenticated
    require_own_page(request)
    found = authenticator.remembered(cookie)
    return found if found is not None else await run_in_threadpool(authenticator.by_session, cookie)


def require_own_page(request: Request) -> None:
    """A browser sends its cookie whoever made it ask: what changes something must come from a page
    of ours. Raises Forbidden.

    SameSite=Strict keeps other sites' requests without the cookie; this holds against other origins
    of the same site, too.
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
    """Scheme and host under which a browser reaches the service; behind a proxy the settings say
    so."""
    public: str | None = request.app.state.parts.settings.public_url
    return (
        public.rstrip("/")
        if public
        else f"{request.url.scheme}://{request.headers.get('host', '')}"
    )


def _require(principal: Principal, rule: Rule) -> None:
    """Raises Forbidden."""
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
    """What a token does not see is answered as what does not exist. Raises NotFound."""
    plant = request.path_params.get("plant")
    if plant is None or principal.everywhere:
        return
    if not await run_in_threadpool(sees, request.app.state.parts.database, principal, plant):
        raise find.not_found("plant", plant)


def sees(database: Database, principal: Principal, plant: str) -> bool:
    """Whether somebody sees a plant that is there."""
    if principal.plant is not None:
        return plant == principal.plant
    if principal.project is None:
        return True
    with reading(database) as tx:
        return tx.plants.is_in_project(plant, principal.project)


async def _principal(request: Request) -> Principal:
    principal: Principal = request.scope["principal"]
    return principal


def require_seen(database: Database, principal: Principal, plant: str, hidden: NotFound) -> None:
    """For what is named without its plant. Raises `hidden`, which says what is said of what does
    not exist."""
    if not principal.everywhere and not sees(database, principal, plant):
        raise hidden


CurrentPrincipal = Annotated[Principal, Depends(_principal)]
