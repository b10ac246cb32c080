"""Drafting: received files become a draft of a plant, and a draft becomes a registered plant."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastapi import Request
from starlette.concurrency import run_in_threadpool

from trueup.canonical import Json
from trueup.recording.described import Described
from trueup_service.actions import find
from trueup_service.actions.idempotency import Created, created_once
from trueup_service.actions.ingestion import ReceivedFile, ingest, plant_context
from trueup_service.actor_context import ActorContext
from trueup_service.authentication import Principal
from trueup_service.drafts import Draft, Drafts
from trueup_service.errors import BadRequest, Forbidden
from trueup_service.http.dependencies import inspector_of
from trueup_service.http.uploads import inspected_episode
from trueup_service.http.uploads import received as received_file
from trueup_service.partial_uploads import digest_of_file
from trueup_service.wiring import Parts


@dataclass(frozen=True, slots=True)
class RegisteredDraft:
    """What was registered from a draft: the plant, its episodes, and its gate if one was
    declared."""

    plant: Created
    episodes: tuple[Created, ...]
    gate: Created | None


def project_of_new_plant(principal: Principal, asked: str | None = None) -> str | None:
    """The project in which somebody registers a plant, None for none. Raises Forbidden, and
    NotFound for a project that the token does not see."""
    if principal.plant is not None:
        raise Forbidden(
            f"the token is of plant {principal.plant!r} alone",
            hint="Ask an admin for a token of the project.",
        )
    if principal.project is not None and asked not in (None, principal.project):
        raise find.not_found("project", str(asked))
    return principal.project or asked


async def receive_draft(
    request: Request, parts: Parts, principal: Principal, name: str, wishes: Mapping[str, Json]
) -> Draft:
    """Receive the body as the files of a draft, and make the draft. Raises BadPlant,
    InspectionFailed, TooLargeUpload, DigestMismatch, BadRequest."""
    drafts, token = Drafts(parts.settings.data_dir), principal.token
    async with received_file(request, parts.spool, parts.settings.upload_limit_bytes) as file:
        with drafts.alone(token, file.digest):
            was_there = drafts.holds(token, file.digest)
            await run_in_threadpool(drafts.receive, token, file.digest, file.path, name)
            try:
                return await _drafted(request, drafts, token, file.digest, wishes)
            except BaseException:
                if not was_there:
                    await run_in_threadpool(drafts.drop, token, file.digest)
                raise


async def revise_draft(
    request: Request, parts: Parts, principal: Principal, digest: str, wishes: Mapping[str, Json]
) -> Draft:
    """Make a draft again, under other wishes; where that is refused it stays as it is. Raises
    NotFound, BadPlant, InspectionFailed."""
    drafts = Drafts(parts.settings.data_dir)
    with drafts.alone(principal.token, digest):
        await run_in_threadpool(drafts.get, principal.token, digest)
        return await _drafted(request, drafts, principal.token, digest, wishes)


async def _drafted(
    request: Request, drafts: Drafts, token: str, digest: str, wishes: Mapping[str, Json]
) -> Draft:
    received, made = drafts.received(token, digest), drafts.new_folder(token, digest)
    try:
        document = await inspector_of(request).draft(received, made, dict(wishes))
        return await run_in_threadpool(
            drafts.keep, token, digest, {**document, "wishes": dict(wishes)}, made
        )
    except BaseException:
        await run_in_threadpool(shutil.rmtree, made, True)
        raise


async def register_draft(
    request: Request,
    parts: Parts,
    context: ActorContext,
    principal: Principal,
    digest: str,
    *,
    declares_gate: bool,
) -> RegisteredDraft:
    """Register the plant that a draft proposes, with its episodes, and then declare the default
    gate, if that is asked for. The draft stays: a request whose answer was lost is sent again, and
    what was registered already is as it is.

    Raises NotFound, BadRequest where the draft proposes no plant yet, Forbidden, Conflict where the
    name is taken.
    """
    drafts = Drafts(parts.settings.data_dir)
    with drafts.alone(principal.token, digest):
        draft = await run_in_threadpool(drafts.get, principal.token, digest)
        document: Any = draft.document["plant"]
        if document is None:
            raise BadRequest(
                "the draft proposes no plant yet",
                hint="Say which signals are meant, and make the draft again.",
            )
        plant, gate = await run_in_threadpool(
            _register, parts, context, principal, document, declares_gate
        )
        episodes = await _ingested(request, parts, context, draft, str(document["name"]))
    return RegisteredDraft(plant, tuple(episodes), gate)


async def _ingested(
    request: Request, parts: Parts, context: ActorContext, draft: Draft, plant: str
) -> list[Created]:
    """The episodes of a draft, as if they had been uploaded to its plant."""
    against = await run_in_threadpool(plant_context, parts, plant)
    listed: Any = draft.document["episodes"]
    episodes = []
    for of in listed:
        copy = await run_in_threadpool(_copied, draft.episode(of["file"]), parts.spool)
        try:
            async with inspected_episode(request, copy, against, Described()) as (file, inspected):
                episodes.append(
                    await run_in_threadpool(
                        ingest, parts, context, plant, None, file, inspected, str(of["file"])
                    )
                )
        finally:
            copy.path.unlink(missing_ok=True)
    return episodes


def _register(
    parts: Parts,
    context: ActorContext,
    principal: Principal,
    document: dict[str, Any],
    declares_gate: bool,
) -> tuple[Created, Created | None]:
    from trueup_service.actions.declare_gate import declare_gate  # noqa: PLC0415  (numpy)
    from trueup_service.actions.register_plant import register_plant  # noqa: PLC0415  (numpy)

    project = project_of_new_plant(principal)
    plant = parts.writer.run(
        created_once(
            context,
            "plants",
            None,
            document,
            lambda tx: register_plant(tx, document, context, project),
        )
    )
    if not declares_gate:
        return plant, None
    name = str(document["name"])
    gate = parts.writer.run(
        created_once(
            context, f"gates/{name}", None, None, lambda tx: declare_gate(tx, name, None, context)
        )
    )
    return plant, gate


def _copied(path: Path, spool: Path) -> ReceivedFile:
    """An episode of a draft as if it was received."""
    copy = spool / uuid.uuid4().hex
    shutil.copyfile(path, copy)
    return ReceivedFile(copy, digest_of_file(copy), copy.stat().st_size)
