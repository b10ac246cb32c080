"""The way to the OpenID provider and back."""

from __future__ import annotations

from urllib.parse import urlencode

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup_service.errors import Forbidden, NotFound, ProviderAway, SignInRefused
from trueup_service.http.dependencies import RequestParts
from trueup_service.http.guard import origin_of
from trueup_service.http.openid import FLOW_COOKIE, PATH, OpenIdProvider
from trueup_service.http.pages.page import own_path, page_router, show, wants_page
from trueup_service.http.sessions import begin_session_of_person, give_cookie
from trueup_service.http.statuses import status_of

router = page_router()


@router.get(PATH)
async def leave(request: Request) -> Response:
    """Go to the provider."""
    to = own_path(request.query_params.get("next", "/"))
    try:
        return await _provider(request).leave(
            request, origin_of(request), to, request.query_params.get("project")
        )
    except ProviderAway as error:
        return _refused(request, to, error)


@router.get(f"{PATH}/callback")
async def arrive(request: Request, parts: RequestParts) -> Response:
    """Begin a session of whoever comes back from the provider. Somebody whose groups allow
    something else in each of several projects chooses one."""
    try:
        arrival = await _provider(request).arrive(request)
        to = own_path(arrival.to)
        chosen = [p for p in arrival.people if (p.project or "") == arrival.project]
        person = (chosen or arrival.people)[0]
        if not chosen and len(arrival.people) > 1:
            choices = [(p.project, p.roles, _path(to, p.project)) for p in arrival.people]
            return _without_flow(show(request, "choose_project.html", choices=choices))
        secret = await run_in_threadpool(begin_session_of_person, parts, person)
    except (SignInRefused, ProviderAway, Forbidden, NotFound) as error:
        return _without_flow(_refused(request, "/", error))
    # A browser that comes from another site would not send the session's cookie after a redirect.
    page = show(request, "signed_in.html", next=to, name=person.name)
    give_cookie(request, page, parts, secret)
    return _without_flow(page)


def _path(to: str, project: str | None) -> str:
    """The way to the provider that chooses a project, or all."""
    return f"{PATH}?{urlencode({'next': to, 'project': project or ''})}"


def _provider(request: Request) -> OpenIdProvider:
    provider: OpenIdProvider | None = request.app.state.openid
    if provider is None:
        raise NotFound(
            "this service has no OpenID provider", hint="Sign in with a token at /sign-in."
        )
    return provider


def _refused(
    request: Request, to: str, error: SignInRefused | ProviderAway | Forbidden | NotFound
) -> Response:
    """The sign-in page with what went wrong. Raises it where no browser asks."""
    if not wants_page(request):
        raise error
    label = request.app.state.parts.settings.openid_label
    return show(request, "sign_in.html", status_of(error), next=to, problem=error, openid=label)


def _without_flow(response: Response) -> Response:
    response.delete_cookie(FLOW_COOKIE, path=PATH, httponly=True, samesite="lax")
    return response
