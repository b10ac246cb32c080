"""Issue and revoke tokens, and make the projects that they are of."""

from __future__ import annotations

from trueup.canonical import Json
from trueup_service.actions import find
from trueup_service.actions.stamp import Stamp
from trueup_service.errors import BadRequest, Conflict
from trueup_service.registry.records import ProjectRecord, Role, TokenRecord
from trueup_service.registry.store import Writer


def create_project(writer: Writer, name: str, stamp: Stamp) -> tuple[ProjectRecord, bool]:
    """The project, and whether it is new."""
    writer.lock_name(f"project {name}")
    known = writer.project(name)
    if known is not None:
        return known, False
    record = ProjectRecord(name, stamp.now, stamp.actor)
    writer.add_project(record)
    writer.append_audit(
        at=stamp.now, kind="project:created", actor=stamp.actor, plant=None, subject=name, facts={}
    )
    return record, True


def issue_token(writer: Writer, token: TokenRecord, stamp: Stamp) -> TokenRecord:
    """Keep a token. Raises NotFound for a project that there is not, BadRequest for a robot of no
    plant."""
    if Role.ROBOT in token.roles and (token.plant is None or len(token.roles) > 1):
        raise BadRequest("a robot's token is of one plant, and has no other role", field="plant")
    if token.project is not None:
        find.project(writer, token.project)
    if token.plant is not None:
        plant = find.plant(writer, token.plant)
        if token.project is not None and plant.project != token.project:
            raise find.missing("plant", token.plant)
    writer.add_token(token)
    facts: dict[str, Json] = {
        "name": token.name,
        "roles": list(token.roles),
        "project": token.project,
        "plant": token.plant,
        "expires_at": token.expires_at,
    }
    writer.append_audit(
        at=stamp.now,
        kind="token:issued",
        actor=stamp.actor,
        plant=token.plant,
        subject=token.prefix,
        facts=facts,
    )
    return token


def revoke_token(writer: Writer, prefix: str, stamp: Stamp) -> TokenRecord:
    """Revoke a token, for good. Raises NotFound, Conflict where it is revoked."""
    found = find.token(writer, prefix)
    if not writer.revoke_token(prefix, stamp.now, stamp.actor):
        raise Conflict(
            "the token is revoked already",
            hint="Nothing is left to do.",
            revoked_at=found.revoked_at,
        )
    facts: dict[str, Json] = {"name": found.name}
    writer.append_audit(
        at=stamp.now,
        kind="token:revoked",
        actor=stamp.actor,
        plant=found.plant,
        subject=prefix,
        facts=facts,
    )
    return find.token(writer, prefix)
