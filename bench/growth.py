"""What serving, listing and proofs cost as a registry grows from 10^2 to 10^6 versions: pairs of
requests, one after the other."""

from __future__ import annotations

import contextlib
import hashlib
import sqlite3
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.generator import get, run
from bench.report import Figure, show
from bench.servers import call, ours
from tests.support.made import plant_document
from trueup.ledger.audit import AuditEntry, entry_bytes
from trueup.ledger.merkle import Frontier, leaf_hash, number_of
from trueup.ledger.rows import row_digest, row_name

SIZES, PAIRS, REQUESTS = (10**2, 10**4, 10**6), 15, 200
AT, BY = "2026-01-01T00:00:00.000000Z", "bench"
ONCE = 20_000
LIMITS = {
    "GET serving": 1.1,
    "list 100 versions": 1.5,
    "get a version": 1.5,
    "prove an entry": 1.5,
    "prove an extension": 1.5,
    "checkpoint": 1.5,
}


def main() -> None:
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        ports = {}
        for size in SIZES:
            data = Path(name) / str(size)
            with ours(data) as (port, _, _):
                call(port, "POST", "/v1/plants", plant_document("p"))
            began = time.perf_counter()
            fill(data / "trueup.sqlite", size)
            print(f"{size} versions written in {time.perf_counter() - began:.0f} s", flush=True)
            ports[size] = stack.enter_context(ours(data))[0]
        figures = []
        for what, limit in LIMITS.items():
            for size in SIZES[1:]:
                ratio, ms = _ratio(ports, what, size)
                told = f"{what} at {size:.0e} beside at 1e+02 ({ms:.2f} ms)"
                figures.append(Figure(told, f"{ratio:.2f} x", f"<= {limit} x", ratio <= limit))
    show("Growth", figures)


def _paths(what: str, size: int) -> list[str]:
    some = np.random.default_rng(0).integers(1, size, REQUESTS)
    return {
        "GET serving": ["/v1/plants/p/serving"] * REQUESTS,
        "list 100 versions": [
            f"/v1/plants/p/artifacts?limit=100&after={max(0, n - 100)}"
            for n in np.minimum(some, size - 100)
        ],
        "get a version": [f"/v1/plants/p/versions/{n}" for n in some],
        "prove an entry": [f"/v1/audit/inclusion?sequence={n}&size={size}" for n in some],
        "prove an extension": [f"/v1/audit/consistency?old={n}&size={size}" for n in some],
        "checkpoint": ["/v1/audit/checkpoint"] * REQUESTS,
    }[what]


def _ratio(ports: dict[int, int], what: str, size: int) -> tuple[float, float]:
    """Median of the ratios of pairs, and the time of a request at this size [ms]."""
    few, many = ([get(path) for path in _paths(what, n)] for n in (SIZES[0], size))
    ratios, seconds = [], []
    for _ in range(PAIRS):
        small, large = _time(ports[SIZES[0]], few), _time(ports[size], many)
        ratios.append(large / small)
        seconds.append(large)
    return float(np.median(ratios)), 1e3 * float(np.median(seconds)) / REQUESTS


def _time(port: int, requests: list[bytes]) -> float:
    began = time.perf_counter()
    done = run(port, [iter(requests)], 60.0)
    assert set(done.statuses) == {200}, done.statuses
    return time.perf_counter() - began


def fill(path: Path, size: int) -> None:
    """Versions 2 to `size`, with the entries and the tree that they would have."""
    kept = sqlite3.connect(path)
    kept.execute("PRAGMA synchronous=OFF")
    frontier = Frontier.from_bytes(
        *kept.execute("SELECT size, frontier FROM audit_head").fetchone()
    )
    versions: list[tuple] = []
    entries: list[tuple] = []
    nodes: list[tuple] = []
    for row, entry in _made(size, frontier.size):
        frontier, completed = frontier.append(leaf_hash(entry_bytes(entry)))
        versions.append(tuple(row.values()))
        rows = f'{{"{next(iter(entry.rows))}":"{next(iter(entry.rows.values()))}"}}'
        entries.append(
            (
                entry.sequence,
                AT,
                entry.kind,
                BY,
                "p",
                entry.subject,
                f'{{"version":{row["version"]}}}',
                rows,
            )
        )
        nodes += [(number_of(node), made) for node, made in completed.items()]
        if len(versions) == ONCE or row["version"] == size:
            kept.executemany(
                f"INSERT INTO artifacts ({', '.join(row)}) VALUES ({', '.join('?' * len(row))})",
                versions,
            )
            columns = 'sequence, at, kind, actor, plant, subject, facts, "rows"'
            kept.executemany(
                f"INSERT INTO audit ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)", entries
            )
            kept.executemany("INSERT INTO audit_tree (node, hash) VALUES (?, ?)", nodes)
            versions, entries, nodes = [], [], []
    kept.execute(
        "UPDATE audit_head SET size = ?, frontier = ?", (frontier.size, frontier.to_bytes())
    )
    kept.commit()
    kept.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    kept.close()


def _made(size: int, sequence: int) -> Iterator[tuple[dict, AuditEntry]]:
    for version in range(2, size + 1):
        digest = hashlib.sha256(b"%d" % version).hexdigest()
        row = {
            "plant": "p",
            "version": version,
            "digest": digest,
            "kind": "identified",
            "manifest": "{}",
            "created_at": AT,
            "created_by": BY,
        }
        named = {row_name("artifacts", row): row_digest("artifacts", row)}
        yield (
            row,
            AuditEntry(
                sequence + version - 1,
                AT,
                "artifact:added",
                BY,
                "p",
                digest,
                {"version": version},
                named,
            ),
        )
