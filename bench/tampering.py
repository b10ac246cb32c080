"""1,000 flipped bytes and every cut tail: how many does the verification find?"""

from __future__ import annotations

import random
import tempfile
import time
from pathlib import Path

from bench.report import Figure, show
from bench.servers import TOKEN
from tests.support.service import Service
from tests.support.storage import embedded
from tests.support.tampering import cut, flip, promoted
from trueup.ledger.verification import verify
from trueup_client import Client
from trueup_service.installation import Installation, published
from trueup_service.signed_log import open_log
from trueup_service.wiring import Parts

FLIPS, SEED = 1000, 2026


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        service = Service(embedded(data / "data"))
        with service.running():
            client = Client(service.url, token=TOKEN)
            promoted(client, data)
            client.close()
        parts = service.storage.build()
        assert not _found(parts), "an untouched installation must hold"
        figures = [_flips(parts), _cuts(parts)]
        parts.close()
    show("Tampering", figures)


def _found(parts: Parts) -> bool:
    return bool(verify(Installation(parts.database, parts.blobs)).findings or published(parts))


def _flips(parts: Parts) -> Figure:
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
        f"flipped bytes found, {each_ms:.0f} ms each",
        f"{found} of {FLIPS}",
        f"{FLIPS}",
        found == FLIPS,
    )


def _cuts(parts: Parts) -> Figure:
    open_log(parts.settings, parts.database).publish()
    entries = list(Installation(parts.database, parts.blobs).entries(0, 10**9))
    found = 0
    for size in reversed(range(len(entries))):
        cut(parts, entries, size)
        found += bool(published(parts))
    return Figure("cut tails found", f"{found} of {len(entries)}", "all", found == len(entries))
