"""Sessions of browsers: a token is exchanged for a cookie that scripts cannot read and other sites
cannot send."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime, timedelta

from fastapi import Request, Response

from trueup_service.actions.tokens import issue_token
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.authentication import Authenticator, Principal, digest_of_secret, new_token
from trueup_service.http.guard import COOKIE, origin_of
from trueup_service.http.openid import Person
from trueup_service.registry.records import TokenRecord
from trueup_service.registry.transaction import Transaction, writing
from trueup_service.wiring import Parts

PROVIDER = "OpenID provider"  # the actor that issues tokens of people


def begin_session(authenticator: Authenticator, parts: Parts, token: str) -> tuple[Principal, str]:
    """Begin a session with a token. Returns its principal and the session's secret. Raises
    Unauthenticated."""
    principal = authenticator.by_token(token)
    with writing(parts.database) as tx:
        return principal, _begin(tx, parts, principal.token, datetime.now(UTC))


def begin_session_of_person(parts: Parts, person: Person) -> str:
    """Begin a session of somebody whom the OpenID provider knows, with a token that nobody holds
    and that ends with the session. Returns the session's secret. Raises NotFound for a project that
    does not exist."""
    now = datetime.now(UTC)
    _, prefix, digest = new_token()
    token = TokenRecord(
        prefix=prefix,
        digest=digest,
        name=person.name,
        roles=list(person.roles),
        project=person.project,
        plant=None,
        created_at=time_text(now),
        created_by=PROVIDER,
        expires_at=time_text(now + timedelta(seconds=parts.settings.session_s)),
    )
    with writing(parts.database) as tx:
        secret = _begin(tx, parts, prefix, now)
        issue_token(tx, token, ActorContext(PROVIDER, time_text(now)))
    return secret


def _begin(tx: Transaction, parts: Parts, token: str, now: datetime) -> str:
    secret = secrets.token_urlsafe(32)
    ends = now + timedelta(seconds=parts.settings.session_s)
    tx.sessions.begin(digest_of_secret(secret), token, time_text(now), time_text(ends))
    return secret


def give_cookie(request: Request, response: Response, parts: Parts, secret: str) -> None:
    """Set the cookie that holds a session's secret, out of reach of scripts and of other sites."""
    is_https = origin_of(request).startswith("https:")
    response.set_cookie(
        COOKIE,
        secret,
        max_age=int(parts.settings.session_s),
        httponly=True,
        samesite="strict",
        secure=is_https,
    )


def end_session(request: Request, parts: Parts) -> None:
    """End the session of a request's cookie."""
    cookie = request.cookies.get(COOKIE)
    if cookie is not None:
        with writing(parts.database) as tx:
            tx.sessions.end(digest_of_secret(cookie))
    request.app.state.authenticator.forget()


def forget_cookie(response: Response) -> None:
    """Delete the cookie."""
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
