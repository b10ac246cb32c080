"""50 seeds of 12 threads and 150 operations over two servers on one PostgreSQL: is every history
that of one register?"""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import closing
from pathlib import Path

from bench.report import Figure, show
from bench.servers import TOKEN
from tests.support.linearizable import prepare, run, violations
from tests.support.postgres import start_postgres
from tests.support.s3 import start_s3
from tests.support.service import Service
from tests.support.storage import Storage, scaled
from trueup.ledger.verification import verify
from trueup_client import Client
from trueup_service.installation import Installation

SEEDS, THREADS, OPERATIONS, GENERATIONS = int(os.environ.get("SEEDS", "50")), 12, 150, 400


def main() -> None:
    with tempfile.TemporaryDirectory() as name, start_postgres() as postgres, start_s3() as s3:
        folder = Path(name)
        storage = scaled(folder / "a", postgres, s3)
        servers = [
            Service(storage),
            Service(
                Storage("scaled", storage.environment | {"TRUEUP_DATA_DIR": str(folder / "b")})
            ),
        ]
        parts = storage.build()
        wrong, moves, operations, began = [], 0, 0, time.monotonic()
        try:
            for server in servers:
                server.start_server()
            with closing(Client(servers[0].url, token=TOKEN)) as client:
                for seed in range(SEEDS):
                    plant = f"p{seed}"
                    decisions = prepare(parts, client, plant, folder, GENERATIONS)
                    found = run(
                        [s.url for s in servers], TOKEN, plant, decisions, THREADS, OPERATIONS, seed
                    )
                    told = list(client.history(plant))
                    wrong += violations(found, told)
                    moves, operations = moves + len(told) - 1, operations + len(found)
                    print(
                        f"seed {seed}: {len(told) - 1} moves, {time.monotonic() - began:.0f} s",
                        flush=True,
                    )
            problems = verify(Installation(parts.database, parts.blobs)).findings
        finally:
            parts.close()
            for server in servers:
                server.stop()
    print(*wrong, *problems, sep="\n")
    figures = [
        Figure(
            f"violations in {operations} operations, {moves} moves, {SEEDS} seeds",
            str(len(wrong)),
            "0",
            not wrong,
        ),
        Figure("audit problems", str(len(problems)), "0", not problems),
    ]
    show("Linearizable", figures)
