"""Issue and revoke tokens, and create projects."""

from __future__ import annotations

from trueup.canonical import Json
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.errors import BadRequest, Conflict
from trueup_service.registry.records import ProjectRecord, Role, TokenRecord
from trueup_service.registry.transaction import Transaction


def create_project(tx: Transaction, name: str, context: ActorContext) -> tuple[ProjectRecord, bool]:
    """Create a project. Returns it, and whether it is new."""
    tx.lock_name(f"project {name}")
    known = tx.projects.get(name)
    if known is not None:
        return known, False
    record = ProjectRecord(name=name, created_at=context.now, created_by=context.actor)
    tx.projects.add(record)
    tx.log.append(context, "project:created", plant=None, subject=name, facts={})
    return record, True


def issue_token(tx: Transaction, token: TokenRecord, context: ActorContext) -> TokenRecord:
    """Add a token. Raises NotFound for an unknown project or plant, and BadRequest for a robot's
    token without a plant or with another role."""
    if Role.ROBOT in token.roles and (token.plant is None or len(token.roles) > 1):
        raise BadRequest("a robot's token is of one plant, and has no other role", field="plant")
    if token.project is not None:
        find.project(tx, token.project)
    if token.plant is not None:
        plant = find.plant(tx, token.plant)
        if token.project is not None and plant.project != token.project:
            raise find.not_found("plant", token.plant)
    tx.tokens.add(token)
    facts: dict[str, Json] = {
        "name": token.name,
        "roles": list(token.roles),
        "project": token.project,
        "plant": token.plant,
        "expires_at": token.expires_at,
    }
    tx.log.append(context, "token:issued", plant=token.plant, subject=token.prefix, facts=facts)
    return token


def revoke_token(tx: Transaction, prefix: str, context: ActorContext) -> TokenRecord:
    """Revoke a token for good. Raises NotFound, and Conflict where it is revoked already."""
    token = find.token(tx, prefix)
    if not tx.tokens.revoke(prefix, context.now, context.actor):
        raise Conflict(
            "the token is revoked already",
            hint="Nothing is left to do.",
            revoked_at=token.revoked_at,
        )
    facts: dict[str, Json] = {"name": token.name}
    tx.log.append(context, "token:revoked", plant=token.plant, subject=prefix, facts=facts)
    return find.token(tx, prefix)
