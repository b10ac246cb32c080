"""Commands that work on the storage itself: backup, restore, export, import, gc."""

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
        help="Public key of the log that it comes from; default: this installation's",
    ),
]
AnyKey = Annotated[
    bool,
    Parameter(
        name="--any-key",
        negative=(),
        help=(
            "Trust the key that the archive names itself: this shows that the archive is whole, "
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
    """Write the whole registry as it is at one moment, while the service runs.

    The signing key is not in it.

    Parameters
    ----------
    to
        a folder, which is brought up to date if it holds an earlier backup, or a .tar file
    """
    _write(to, None, as_json_=as_json_)


def export(plant: PlantName, to: Path, *, as_json_: Json = False) -> None:
    """Write a plant with its whole history.

    It holds episodes, artifacts, gates, decisions, moves, and the plant's part of the log with
    proofs.

    Parameters
    ----------
    to
        a folder, or a file that ends in .tar
    """
    _write(to, plant, as_json_=as_json_)


def _write(to: Path, plant: str | None, *, as_json_: bool) -> None:
    from trueup_service.archives import export as write_archive
    from trueup_service.signed_log import open_log

    with _parts() as parts, progress(f"writing {to}") as bar:
        digest = write_archive(
            parts, open_log(parts.settings, parts.database), to, plant, _now(), bar
        )
    as_json({"archive": str(to), "digest": f"sha256:{digest}"}) if as_json_ else say(
        "{} is sha256:{}", to, digest
    )


def restore(
    source: Path, *, key: LogKey = None, any_key: AnyKey = False, as_json_: Json = False
) -> None:
    """Restore a backup into empty storage, once it is verified against its own log.

    Jobs that were under way go on.

    Parameters
    ----------
    source
        the folder or file that `trueup backup` wrote
    """
    from trueup_service.archives import restore as restore_archive

    with (
        _verified_archive(source, key, any_key=any_key) as archive,
        _parts() as parts,
        progress("restoring") as bar,
    ):
        jobs = restore_archive(parts, archive, bar)
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
    project: Annotated[str | None, Parameter(help="Project that the plant will belong to")] = None,
    key: LogKey = None,
    any_key: AnyKey = False,
    as_json_: Json = False,
) -> None:
    """Import a plant with its history, once it is verified against the log that it comes from.

    Parameters
    ----------
    source
        the folder or file that `trueup export` wrote
    """
    from trueup_service.actor_context import ActorContext
    from trueup_service.archives import import_plant

    with (
        _verified_archive(source, key, any_key=any_key) as archive,
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
def _verified_archive(source: Path, key: str | None, *, any_key: bool) -> Iterator[Archive]:
    """Opens an archive whose manifest a trusted key signed, and verifies it against the manifest.

    The signature is checked before anything else is read. Raises KeyNotGiven, NotSigned, NotWhole,
    BadArchive.
    """
    from trueup.ledger.archive import Archive, ManifestSignature
    from trueup.ledger.archive_layout import statement_of
    from trueup_client.problem import NotSigned
    from trueup_client.proof import Checkpoint, Key, includes
    from trueup_service.archives import require_whole
    from trueup_service.errors import KeyNotGiven
    from trueup_service.settings import Settings
    from trueup_service.signed_log import own_key

    named_key, own = (
        None if text is None else Key.from_text(text) for text in (key, own_key(Settings()))
    )

    def signers(endorsements: Iterable[str]) -> list[Key]:
        """Returns the keys that may have signed, the one in use last.

        They are the key named on the command line, else our own, and its successors.
        """
        first = named_key or own
        return [] if first is None else [first, *first.followed(endorsements)]

    def is_signed(by: ManifestSignature) -> bool:
        statement = statement_of(f"sha256:{by.digest}")
        return any(k.signed(by.signature, statement) for k in signers(by.endorsements))

    archive = Archive(source, is_signed)
    try:
        statement, named = statement_of(f"sha256:{archive.digest}"), str(archive.config["key"])
        trusted = signers(archive.endorsements)[-1:]
        if named_key is None and not any(k.signed(archive.signature, statement) for k in trusted):
            if not any_key:
                raise KeyNotGiven(
                    f"only the archive itself says that it is signed with {named}",
                    key=named,
                )
            say(
                "[bold]Its origin is not verified[/]: the key comes from the archive itself, {}",
                named,
                to=err,
            )
            trusted = [Key.from_text(named)]
            trusted += trusted[0].followed(archive.endorsements)
        Checkpoint.of(str(archive.config["checkpoint"]), trusted[-1])
        if not trusted[-1].signed(archive.signature, statement):
            raise NotSigned("the archive is not the one that its site signed")
        with progress("verifying") as bar:
            require_whole(archive, includes, bar)
        yield archive
    finally:
        archive.close()


def gc(
    *,
    older_than_h: Annotated[
        float, Parameter(help="Keep what came in less than this ago [h]")
    ] = 24.0,
    dry_run: Annotated[bool, Parameter(negative=(), help="Only say what would be removed")] = False,
    as_json_: Json = False,
) -> None:
    """Remove bytes that no row names, such as those of uploads that never ended.

    What was registered is never removed.
    """
    from trueup_service.garbage_collection import collect_garbage

    with _parts() as parts, progress("looking for bytes that no row names") as bar:
        removed: dict[str, Any] = collect_garbage(
            parts, older_than_h * 3600.0, dry_run=dry_run, progress=bar
        )
    if as_json_:
        as_json({**removed, "dry_run": dry_run})
        return
    were = "would be" if dry_run else "were"
    say(
        "{} blobs and {} files of uploads {} removed, {:.1f} MB",
        removed["blobs"],
        removed["files"],
        were,
        removed["bytes"] / 1e6,
    )
