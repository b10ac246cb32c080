"""`trueup fsck`: is what this installation keeps whole, and is it what its log tells?"""

from __future__ import annotations

import sys

from trueup_cli.exits import DISAGREES
from trueup_cli.options import Json
from trueup_cli.show import as_json, err, progress, say, table


def fsck(*, as_json_: Json = False) -> None:
    """Check the storage that the settings name, without a server or beside a running one; exit 4
    with a list if anything is wrong.

    A data folder that cannot be written, such as a mounted snapshot, is read as it is.
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
        found = verify(Installation(parts.database, parts.blobs, signing(parts)), bar)
        wrong = [
            (f.where, f.what)
            for f in [
                *found.findings,
                *published(parts),
                *lost_jobs(parts),
                *altered(parts.database),
            ]
        ]
        left = unnamed_blobs(parts)
    if as_json_:
        as_json(
            {
                "entries": found.size,
                "rows": found.rows,
                "bytes": found.bytes,
                "findings": wrong,
                "unnamed_blobs": len(left),
            }
        )
    elif wrong:
        table("", ["where", "what is wrong"], wrong)
    else:
        say(
            "[bold green]whole[/]: {} entries, {} rows, {:.1f} MB",
            found.size,
            found.rows,
            found.bytes / 1e6,
        )
    if left and not as_json_:
        say(
            (
                "{} blobs are named by no row: uploads under way, or left over; `trueup gc` "
                "removes old ones."
            ),
            len(left),
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
