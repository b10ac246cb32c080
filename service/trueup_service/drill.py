"""A drill of backup and restore: the registry is backed up while it is used, the backup is verified
as a stranger's would be, restored into empty storage, and checked there.

The restored copy is on embedded storage, in a folder that is removed in the end.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from trueup.ledger.archive import Archive, ManifestSignature
from trueup.ledger.archive_layout import statement_of
from trueup.ledger.verification import Finding, verify
from trueup_client.proof import Key, includes
from trueup_service.archives import export, require_whole, restore
from trueup_service.installation import Installation, lost_jobs
from trueup_service.registry.schema import altered
from trueup_service.registry.transaction import reading
from trueup_service.settings import Settings
from trueup_service.signed_log import SignedLog
from trueup_service.wiring import Parts, build

Progress = Callable[[float, str], None]
# of the drill's time, roughly: until the backup is written, verified, restored
WRITTEN, VERIFIED, RESTORED = 0.25, 0.5, 0.75


@dataclass(frozen=True, slots=True)
class Drill:
    """What a drill did: what was restored, how long each step took [s], how many unfinished jobs
    would go on, and what was wrong with the restored copy."""

    entries: int
    rows: int
    bytes: int
    jobs: int
    backup_s: float
    verify_s: float
    restore_s: float
    check_s: float
    findings: tuple[Finding, ...]


def drill(parts: Parts, log: SignedLog, within: Path | None, now: str, progress: Progress) -> Drill:
    """Back up, verify, restore and check, in a folder made `within` one, or where temporary files
    go. It takes as much room as the registry twice. Raises NotWhole, BadArchive, OSError."""
    with tempfile.TemporaryDirectory(prefix="trueup-drill-", dir=within) as made:
        folder, times = Path(made), [time.monotonic()]
        export(parts, log, folder / "backup", None, now, _part(progress, 0.0, WRITTEN))
        times.append(time.monotonic())
        with closing(_opened(folder / "backup", log.signer.verifier)) as archive:
            require_whole(archive, includes, _part(progress, WRITTEN, VERIFIED))
            times.append(time.monotonic())
            with closing(_empty(folder / "restored")) as restored:
                jobs = restore(restored, archive, _part(progress, VERIFIED, RESTORED))
                times.append(time.monotonic())
                verified = verify(
                    Installation(restored.database, restored.blobs),
                    _part(progress, RESTORED, 1.0),
                )
                findings = [
                    *verified.findings,
                    *lost_jobs(restored),
                    *altered(restored.database),
                    *_other_head(restored, archive),
                ]
        times.append(time.monotonic())
    backup_s, verify_s, restore_s, check_s = (after - before for before, after in pairwise(times))
    return Drill(
        verified.size,
        verified.rows,
        verified.bytes,
        jobs,
        backup_s,
        verify_s,
        restore_s,
        check_s,
        tuple(findings),
    )


def _opened(path: Path, verifier: str) -> Archive:
    key = Key.from_text(verifier)

    def is_signed(by: ManifestSignature) -> bool:
        return key.signed(by.signature, statement_of(f"sha256:{by.digest}"))

    return Archive(path, is_signed)


def _empty(folder: Path) -> Parts:
    """Empty embedded storage in a folder."""
    return build(Settings(data_dir=folder, database_url=None, s3_bucket=None))


def _other_head(restored: Parts, archive: Archive) -> list[Finding]:
    with reading(restored.database) as tx:
        tree = tx.log.tree()
    return (
        []
        if (tree.size, tree.root()) == archive.head()
        else [Finding("log", "it does not end where the backup's does")]
    )


def _part(progress: Progress, begin: float, end: float) -> Progress:
    return lambda share, what: progress(begin + share * (end - begin), what)
