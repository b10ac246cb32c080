"""Routes of sessions, projects and tokens."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import Query, Request, Response

from trueup_service.actions.tokens import create_project, issue_token, revoke_token
from trueup_service.actor_context import time_text
from trueup_service.authentication import new_token
from trueup_service.http.dependencies import (
    IdempotencyKey,
    Limit,
    RequestContext,
    RequestParts,
    TokenPrefix,
    create,
)
from trueup_service.http.guard import CurrentPrincipal, guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.access import (
    Identity,
    IssuedToken,
    NewProject,
    NewToken,
    Project,
    SignIn,
    Token,
)
from trueup_service.http.schemas.wire import Page, page
from trueup_service.http.sessions import begin_session, end_session, forget_cookie, give_cookie
from trueup_service.registry.records import Role, TokenRecord
from trueup_service.registry.transaction import reading, writing

router = guarded("/v1", ["access"])


@router.post("/session", summary="Sign in with a token, for a browser")
def sign_in(
    request: Request, response: Response, parts: RequestParts, credential: SignIn
) -> Identity:
    """Sets a cookie that scripts cannot read and other sites cannot send. Programs send their token
    with every request instead."""
    principal, secret = begin_session(request.app.state.authenticator, parts, credential.token)
    give_cookie(request, response, parts, secret)
    return Identity.model_validate(principal)


@router.get("/session", summary="Who asks")
async def session(principal: CurrentPrincipal) -> Identity:
    return Identity.model_validate(principal)


@router.delete("/session", summary="Sign out", status_code=204)
def sign_out(request: Request, response: Response, parts: RequestParts) -> None:
    end_session(request, parts)
    forget_cookie(response)


@router.post(
    "/projects",
    status_code=201,
    response_model=Project,
    summary="Create a project",
    responses=already_exists(Project),
)
def add_project(
    parts: RequestParts, context: RequestContext, project: NewProject, key: IdempotencyKey = None
) -> Response:
    return create(
        parts,
        context,
        "projects",
        key,
        project.model_dump(),
        lambda tx: create_project(tx, project.name, context),
        Project,
    )


@router.get("/projects", summary="List projects")
def list_projects(
    parts: RequestParts, after: Annotated[str, Query(max_length=63)] = "", limit: Limit = 100
) -> Page[Project]:
    with reading(parts.database) as tx:
        projects = tx.projects.page(after, limit)
    return page(Project, projects, limit, "name")


@router.post("/tokens", status_code=201, summary="Issue a token")
def issue(parts: RequestParts, context: RequestContext, wanted: NewToken) -> IssuedToken:
    """The response is the only one that has `token`; the service stores its hash. A robot's token
    is of one plant. The route takes no idempotency key, since a repeated response would have to
    keep the secret. Revoke a token that did not arrive."""
    text, prefix, digest = new_token()
    expires = (
        None if wanted.days is None else time_text(datetime.now(UTC) + timedelta(days=wanted.days))
    )
    roles = [role.value for role in Role if role in wanted.roles]
    record = TokenRecord(
        prefix=prefix,
        digest=digest,
        name=wanted.name,
        roles=roles,
        project=wanted.project,
        plant=wanted.plant,
        created_at=context.now,
        created_by=context.actor,
        expires_at=expires,
    )
    with writing(parts.database) as tx:
        issued = issue_token(tx, record, context)
    return IssuedToken(**Token.model_validate(issued).model_dump(), token=text)


@router.get("/tokens", summary="List tokens")
def list_tokens(
    parts: RequestParts, after: Annotated[str, Query(max_length=16)] = "", limit: Limit = 100
) -> Page[Token]:
    with reading(parts.database) as tx:
        tokens = tx.tokens.page(after, limit)
    return page(Token, tokens, limit, "prefix")


@router.post("/tokens/{prefix}/revoke", summary="Revoke a token")
def revoke(
    request: Request, parts: RequestParts, context: RequestContext, prefix: TokenPrefix
) -> Token:
    """A token is revoked for good. Other servers refuse it within `token_memory_s`."""
    with writing(parts.database) as tx:
        revoked = revoke_token(tx, prefix, context)
    request.app.state.authenticator.forget()
    return Token.model_validate(revoked)
