"""The door: every route asks here who comes, before a byte of the body is read."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Request
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from trueup_service.actions import find
from trueup_service.errors import Forbidden, NotFound, Unauthenticated
from trueup_service.http.access import ACCESS, Rule
from trueup_service.identity import Identities, Who
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
                who = scope["who"] = await _recognised(request)
                _require(who, rule)
                await _require_plant(request, who)
        await super().handle(scope, receive, send)


def guarded(prefix: str, tags: list[str]) -> APIRouter:
    """A router whose routes are guarded."""
    return APIRouter(prefix=prefix, tags=list(tags), route_class=Guarded)


async def _recognised(request: Request) -> Who:
    identities: Identities = request.app.state.identities
    kind, _, token = request.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        found = identities.remembered(token)
        return found if found is not None else await run_in_threadpool(identities.by_token, token)
    cookie = request.cookies.get(COOKIE)
    if cookie is None:
        raise Unauthenticated
    require_own_page(request)
    found = identities.remembered(cookie)
    return found if found is not None else await run_in_threadpool(identities.by_session, cookie)


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


def _require(who: Who, rule: Rule) -> None:
    """Raises Forbidden."""
    if not who.roles & rule.roles:
        roles = sorted(rule.roles)
        raise Forbidden(
            f"{who.name!r} is {' and '.join(sorted(who.roles))}; this takes {' or '.join(roles)}",
            roles=roles,
        )
    if rule.everywhere and not who.everywhere:
        raise Forbidden(
            "this shows all projects, and the token is of one",
            hint="Ask an admin for a token of all projects.",
        )


async def _require_plant(request: Request, who: Who) -> None:
    """What a token does not see is answered as what does not exist. Raises NotFound."""
    plant = request.path_params.get("plant")
    if plant is None or who.everywhere:
        return
    if not await run_in_threadpool(sees, request.app.state.parts.database, who, plant):
        raise find.not_found("plant", plant)


def sees(database: Database, who: Who, plant: str) -> bool:
    """Whether somebody sees a plant that is there."""
    if who.plant is not None:
        return plant == who.plant
    if who.project is None:
        return True
    with reading(database) as tx:
        return tx.plants.is_in_project(plant, who.project)


async def _who(request: Request) -> Who:
    who: Who = request.scope["who"]
    return who


def require_seen(database: Database, who: Who, plant: str, hidden: NotFound) -> None:
    """For what is named without its plant. Raises `hidden`, which says what is said of what does
    not exist."""
    if not who.everywhere and not sees(database, who, plant):
        raise hidden


Asking = Annotated[Who, Depends(_who)]
