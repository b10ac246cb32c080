"""What a service acknowledged, compared with what it has in the end.

Nothing may be lost, torn or done twice, and every job must have ended.
"""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass, field

from trueup.ledger.verification import verify
from trueup_service.installation import Installation, lost_jobs
from trueup_service.registry.records import FINAL
from trueup_service.registry.transaction import ReadTransaction
from trueup_service.wiring import Parts

KINDS_ONCE = (
    "episode:ingested",
    "artifact:added",
    "gate:declared",
    "decision:made",
    "job:submitted",
    "job:finished",
    "plant:registered",
)


@dataclass
class History:
    """What a service acknowledged.

    Episodes and gates are (plant, digest), jobs are ids, moves are (plant, generation, artifact).
    """

    episodes: set[tuple[str, str]] = field(default_factory=set)
    gates: set[tuple[str, str]] = field(default_factory=set)
    jobs: set[str] = field(default_factory=set)
    moves: set[tuple[str, int, str]] = field(default_factory=set)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def note(self, kind: str, what: object) -> None:
        """Adds an acknowledged item of one kind, from any thread."""
        with self.lock:
            getattr(self, kind).add(what)

    def __len__(self) -> int:
        return len(self.episodes) + len(self.gates) + len(self.jobs) + len(self.moves)


def problems(history: History, parts: Parts) -> list[str]:
    """Returns what is lost, torn, doubled or never ended."""
    wrong = [
        f"torn: {f.where}: {f.what}"
        for f in verify(Installation(parts.database, parts.blobs)).findings
    ]
    wrong += [f"lost: {f.where}: {f.what}" for f in lost_jobs(parts)]
    with parts.database.read() as connection:
        tx = ReadTransaction(connection)
        wrong += [f"lost: episode {e}" for e in history.episodes if tx.episodes.get(*e) is None]
        wrong += [f"lost: gate {g}" for g in history.gates if tx.gates.get(*g) is None]
        for job in history.jobs:
            record = tx.jobs.get(job)
            if record is None or record.state not in FINAL:
                wrong.append(f"lost: job {job} is {record and record.state}")
        for plant, generation, artifact in history.moves:
            move = tx.serving.at_generation(plant, generation)
            if move is None or move.artifact != artifact:
                wrong.append(f"lost: move {generation} of {plant}")
        entries = tx.log.entries(0, 10**9)
    counted = Counter((e.kind, e.plant, e.subject) for e in entries if e.kind in KINDS_ONCE)
    wrong += [f"doubled: {key}" for key, times in counted.items() if times > 1]
    generations = Counter(
        (e.plant, e.facts["generation"]) for e in entries if e.kind == "pointer:moved"
    )
    return wrong + [f"doubled: generation {key}" for key, times in generations.items() if times > 1]
