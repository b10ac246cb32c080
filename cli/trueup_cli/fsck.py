"""`trueup fsck`: check an installation's storage against its log."""

from __future__ import annotations

import sys
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from trueup_cli.exits import DISAGREES
from trueup_cli.options import Json
from trueup_cli.show import as_json, err, progress, say, table

if TYPE_CHECKING:
    from trueup_service.drill import Drill


def fsck(
    *,
    drill: Annotated[
        bool,
        Parameter(
            negative=(), help="Then rehearse a backup and its restore, which is checked, too"
        ),
    ] = False,
    drill_in: Annotated[
        Path | None,
        Parameter(help="Folder with room for the registry twice; default: for temporary files"),
    ] = None,
    as_json_: Json = False,
) -> None:
    """Check the storage that the settings name, also while a server runs on it.

    If anything is wrong it is listed, and the exit code is 4. A data folder that cannot be written,
    such as a mounted snapshot, is read as it is. A drill backs the registry up, verifies the backup
    against the log, restores it into empty embedded storage, checks that, and removes it again.
    """
    from trueup.ledger.verification import verify
    from trueup_service.installation import (
        Installation,
        lost_jobs,
        published,
        signing,
        unnamed_blobs,
    )
    from trueup_service.registry.schema import altered
    from trueup_service.settings import Settings
    from trueup_service.wiring import build_to_read

    with build_to_read(Settings()) as parts, progress("checking") as bar:
        verified = verify(Installation(parts.database, parts.blobs, signing(parts)), bar)
        wrong = [
            (f.where, f.what)
            for f in [
                *verified.findings,
                *published(parts),
                *lost_jobs(parts),
                *altered(parts.database),
            ]
        ]
        unnamed = unnamed_blobs(parts)
    rehearsed = None
    if drill and wrong:
        say("the drill is left out: first mend what is wrong here", to=err)
    elif drill:
        rehearsed, refused = _drill(drill_in)
        wrong += refused
    if as_json_:
        as_json(
            {
                "entries": verified.size,
                "rows": verified.rows,
                "bytes": verified.bytes,
                "findings": wrong,
                "unnamed_blobs": len(unnamed),
                "drill": _document(rehearsed),
            }
        )
    elif wrong:
        table("", ["where", "what is wrong"], wrong)
    else:
        say(
            "[bold green]whole[/]: {} entries, {} rows, {:.1f} MB",
            verified.size,
            verified.rows,
            verified.bytes / 1e6,
        )
    if rehearsed is not None and not as_json_:
        say(
            "the drill backed up in {:.1f} s, verified in {:.1f} s, restored in {:.1f} s and "
            "checked in {:.1f} s: {} entries, {} rows, {:.1f} MB; {} jobs would go on",
            rehearsed.backup_s,
            rehearsed.verify_s,
            rehearsed.restore_s,
            rehearsed.check_s,
            rehearsed.entries,
            rehearsed.rows,
            rehearsed.bytes / 1e6,
            rehearsed.jobs,
        )
    if unnamed and not as_json_:
        say(
            (
                "{} blobs are named by no row: uploads under way, or left over; `trueup gc` "
                "removes old ones."
            ),
            len(unnamed),
        )
    if wrong:
        say(
            (
                "[bold red]wrong[/] {} things: restore them from a backup (`trueup restore`), "
                "or from a mirror."
            ),
            len(wrong),
            to=err,
        )
        sys.exit(DISAGREES)


def _drill(within: Path | None) -> tuple[Drill | None, list[tuple[str, str]]]:
    """Returns the drill, None where the backup does not hold, and what is wrong."""
    from trueup.ledger.archive_layout import BadArchive
    from trueup_service.actor_context import time_text
    from trueup_service.drill import drill
    from trueup_service.errors import NotWhole
    from trueup_service.settings import Settings
    from trueup_service.signed_log import open_log
    from trueup_service.wiring import build

    parts = build(Settings())
    try:
        with progress("rehearsing backup and restore") as bar:
            now = time_text(datetime.now(UTC))
            done = drill(parts, open_log(parts.settings, parts.database), within, now, bar)
    except (NotWhole, BadArchive) as error:
        return None, [("backup", error.message)]
    finally:
        parts.close()
    return done, [(f"restored copy: {f.where}", f.what) for f in done.findings]


def _document(rehearsed: Drill | None) -> dict[str, Any] | None:
    if rehearsed is None:
        return None
    return {**asdict(rehearsed), "findings": [asdict(f) for f in rehearsed.findings]}
