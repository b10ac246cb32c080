"""1,000 flipped bytes and every cut tail, on both storages: how many does the verification find?

Environment: `FLIPS`, how many (1000); `STORAGES`, `embedded`, `scaled` or both.
"""

from __future__ import annotations

import os
import random
import tempfile
import time
from pathlib import Path

from bench.report import Figure, show
from bench.servers import TOKEN
from tests.support.postgres import start_postgres
from tests.support.s3 import start_s3
from tests.support.service import Service
from tests.support.storage import Storage, embedded, scaled
from tests.support.tampering import cut, flip, promoted
from trueup.ledger.verification import verify
from trueup_client import Client
from trueup_service.installation import Installation, published
from trueup_service.signed_log import open_log
from trueup_service.wiring import Parts

FLIPS, SEED = int(os.environ.get("FLIPS", "1000")), 2026
STORAGES = os.environ.get("STORAGES", "embedded scaled").split()


def main() -> None:
    with tempfile.TemporaryDirectory() as name, start_postgres() as postgres, start_s3() as s3:
        folder = Path(name)
        figures = [
            figure
            for storage in (embedded(folder / "a"), scaled(folder / "b", postgres, s3))
            if storage.name in STORAGES
            for figure in _tampered(storage, folder)
        ]
    show("Tampering", figures)


def _tampered(storage: Storage, folder: Path) -> list[Figure]:
    service = Service(storage)
    with service.running():
        client = Client(service.url, token=TOKEN)
        promoted(client, folder)
        client.close()
    parts = storage.build()
    assert not _found(parts), "an untouched installation must hold"
    figures = [_flips(storage.name, parts), _cuts(storage.name, parts)]
    parts.close()
    return figures


def _found(parts: Parts) -> bool:
    return bool(verify(Installation(parts.database, parts.blobs)).findings or published(parts))


def _flips(storage: str, parts: Parts) -> Figure:
    rng, began, found, missed = random.Random(SEED), time.perf_counter(), 0, []
    for _ in range(FLIPS):
        flipped = flip(parts, rng)
        if _found(parts):
            found += 1
        else:
            missed.append(flipped.where)
        flipped.undo()
    assert not _found(parts)
    print(*missed, sep="\n")
    each_ms = (time.perf_counter() - began) / FLIPS * 1000
    return Figure(
        f"{storage}: flipped bytes found, {each_ms:.0f} ms each",
        f"{found} of {FLIPS}",
        f"{FLIPS}",
        found == FLIPS,
    )


def _cuts(storage: str, parts: Parts) -> Figure:
    open_log(parts.settings, parts.database).publish()
    entries = list(Installation(parts.database, parts.blobs).entries(0, 10**9))
    found = 0
    for size in reversed(range(len(entries))):
        cut(parts, entries, size)
        found += bool(published(parts))
    return Figure(
        f"{storage}: cut tails found",
        f"{found} of {len(entries)}",
        "all",
        found == len(entries),
    )
