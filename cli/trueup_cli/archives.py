"""Commands that take a registry or a plant out, and bring it in: backup, restore, export, import,
gc. They work on the storage itself."""

from __future__ import annotations

import getpass
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from trueup_cli.options import Json, PlantName
from trueup_cli.show import as_json, err, progress, say

if TYPE_CHECKING:
    from trueup.ledger.archive import Archive
    from trueup_service.wiring import Parts

LogKey = Annotated[
    str | None,
    Parameter(
        name="--key",
        env_var="TRUEUP_LOG_KEY",
        help="Public key of the log that it comes from; default: that of this installation",
    ),
]
AnyKey = Annotated[
    bool,
    Parameter(
        name="--any-key",
        negative=(),
        help=(
            "Believe the key that the archive names itself, which shows that it is whole, "
            "not whose it is"
        ),
    ),
]


@contextmanager
def _parts() -> Iterator[Parts]:
    from trueup_service.settings import Settings
    from trueup_service.wiring import build

    parts = build(Settings())
    try:
        yield parts
    finally:
        parts.close()


def _now() -> str:
    from trueup_service.actor_context import time_text

    return time_text(datetime.now(UTC))


def backup(to: Path, *, as_json_: Json = False) -> None:
    """Write all that is kept, as it is at one moment, while the service runs; the signing key is
    not in it.

    Parameters
    ----------
    to
        a folder, which keeps what it has of an earlier backup, or a file that ends in .tar
    """
    _write(to, None, as_json_=as_json_)


def export(plant: PlantName, to: Path, *, as_json_: Json = False) -> None:
    """Write a plant with its whole history: episodes, artifacts, gates, decisions, moves, and its
    part of the log with proofs.

    Parameters
    ----------
    to
        a folder, or a file that ends in .tar
    """
    _write(to, plant, as_json_=as_json_)


def _write(to: Path, plant: str | None, *, as_json_: bool) -> None:
    from trueup_service.archives import export as write
    from trueup_service.signed_log import open_log

    with _parts() as parts, progress(f"writing {to}") as bar:
        digest = write(parts, open_log(parts.settings, parts.database), to, plant, _now(), bar)
    as_json({"archive": str(to), "digest": f"sha256:{digest}"}) if as_json_ else say(
        "{} is sha256:{}", to, digest
    )


def restore(
    source: Path, *, key: LogKey = None, any_key: AnyKey = False, as_json_: Json = False
) -> None:
    """Bring a backup back into empty storage, once it holds against its own log; jobs that were
    under way go on.

    Parameters
    ----------
    source
        what `trueup backup` wrote
    """
    from trueup_service.archives import restore as bring

    with (
        _whole(source, key, any_key=any_key) as archive,
        _parts() as parts,
        progress("restoring") as bar,
    ):
        jobs = bring(parts, archive, bar)
    if as_json_:
        as_json({"as_of": archive.config["created_at"], "jobs": jobs})
        return
    say("restored as it was {}; {} jobs go on", archive.config["created_at"], jobs)
    say(
        "Its log is signed with the key that it had: give it back as TRUEUP_SIGNING_KEY, or "
        "as signing.key."
    )


def import_(
    source: Path,
    *,
    project: Annotated[str | None, Parameter(help="The plant will be of it")] = None,
    key: LogKey = None,
    any_key: AnyKey = False,
    as_json_: Json = False,
) -> None:
    """Bring a plant in with its history, once it holds against the log that it comes from.

    Parameters
    ----------
    source
        what `trueup export` wrote
    """
    from trueup_service.actor_context import ActorContext
    from trueup_service.archives import import_plant

    with (
        _whole(source, key, any_key=any_key) as archive,
        _parts() as parts,
        progress("importing") as bar,
    ):
        actor = os.environ.get("TRUEUP_ACTOR") or getpass.getuser()
        plant = import_plant(
            parts, archive, project, ActorContext(f"command for {actor}", _now()), bar
        )
    log = archive.config["checkpoint"].splitlines()[0]
    as_json({"plant": plant, "from": log}) if as_json_ else say(
        "plant [bold]{}[/] is here, from {}", plant, log
    )


@contextmanager
def _whole(source: Path, key: str | None, *, any_key: bool) -> Iterator[Archive]:
    """An archive whose head is signed by a key that is believed, and that holds against it: the
    signature of its manifest is checked before anything else is read.

    Raises KeyNotGiven, NotSigned, NotWhole, BadArchive.
    """
    from trueup.ledger.archive import Archive, ManifestSignature
    from trueup.ledger.archive_layout import statement_of
    from trueup_client.problem import NotSigned
    from trueup_client.proof import Checkpoint, Key, includes
    from trueup_service.archives import require_whole
    from trueup_service.errors import KeyNotGiven
    from trueup_service.settings import Settings
    from trueup_service.signed_log import own_key

    given, own = (
        None if text is None else Key.from_text(text) for text in (key, own_key(Settings()))
    )

    def signers(endorsements: Iterable[str]) -> list[Key]:
        """The keys that may have signed, of which the last one does now: what was given and its
        heirs, else ours and its own."""
        first = given or own
        return [] if first is None else [first, *first.followed(endorsements)]

    def signed(by: ManifestSignature) -> bool:
        return any(
            k.signed(by.signature, statement_of(f"sha256:{by.digest}"))
            for k in signers(by.endorsements)
        )

    archive = Archive(source, signed)
    try:
        statement, named = statement_of(f"sha256:{archive.digest}"), str(archive.config["key"])
        believed = signers(archive.endorsements)[-1:]
        if given is None and not any(k.signed(archive.signature, statement) for k in believed):
            if not any_key:
                raise KeyNotGiven(
                    f"the archive says that it is signed with {named}, and nobody else does",
                    key=named,
                )
            say(
                "[bold]Whose it is, nobody has shown[/]: the archive names its own key, {}",
                named,
                to=err,
            )
            believed = [Key.from_text(named)]
            believed += believed[0].followed(archive.endorsements)
        Checkpoint.of(str(archive.config["checkpoint"]), believed[-1])
        if not believed[-1].signed(archive.signature, statement):
            raise NotSigned("the archive is not the one that its site signed")
        with progress("verifying") as bar:
            require_whole(archive, includes, bar)
        yield archive
    finally:
        archive.close()


def gc(
    *,
    older_than_h: Annotated[
        float, Parameter(help="Leave what came in later than this alone [h]")
    ] = 24.0,
    dry_run: Annotated[bool, Parameter(negative=(), help="Only say what would be removed")] = False,
    as_json_: Json = False,
) -> None:
    """Remove bytes that no row names: what uploads left that never ended. What was registered is
    never removed."""
    from trueup_service.garbage_collection import collect_garbage

    with _parts() as parts, progress("looking for what is left over") as bar:
        removed: dict[str, Any] = collect_garbage(
            parts, older_than_h * 3600.0, dry_run=dry_run, progress=bar
        )
    if as_json_:
        as_json({**removed, "dry_run": dry_run})
        return
    what = "would be" if dry_run else "were"
    megabytes = removed["bytes"] / 1e6
    say(
        "{} blobs and {} files of uploads {} removed, {:.1f} MB",
        removed["blobs"],
        removed["files"],
        what,
        megabytes,
    )
