"""`trueup fsck`: check an installation's storage against its log."""

from __future__ import annotations

import sys

from trueup_cli.exits import DISAGREES
from trueup_cli.options import Json
from trueup_cli.show import as_json, err, progress, say, table


def fsck(*, as_json_: Json = False) -> None:
    """Check the storage that the settings name, also while a server runs on it.

    If anything is wrong it is listed, and the exit code is 4. A data folder that cannot be written,
    such as a mounted snapshot, is read as it is.
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
    if as_json_:
        as_json(
            {
                "entries": verified.size,
                "rows": verified.rows,
                "bytes": verified.bytes,
                "findings": wrong,
                "unnamed_blobs": len(unnamed),
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
