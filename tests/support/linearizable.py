"""A check that the serving pointer of several servers is linearizable, as one register.

Each move takes a generation of its own. So a history is linearizable exactly if no operation that
began after another had ended shows an earlier generation, every generation shows one artifact, and
no two acknowledged moves have the same generation.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.made import episode_bytes, identified, plant_document, save
from trueup.episode.role import Role
from trueup_client import Client, Problem, Serving
from trueup_service.actions.record_decision import record_decision
from trueup_service.actor_context import ActorContext
from trueup_service.registry.transaction import writing
from trueup_service.wiring import Parts


@dataclass(frozen=True)
class Operation:
    """One operation: when it began and ended [s], and the position that it showed.

    The position is None if the operation was refused.
    """

    kind: str
    began: float
    ended: float
    generation: int | None
    artifact: str | None


# from generation and incumbent to an accepted decision
Decisions = Mapping["tuple[int, str]", str]


def prepare(parts: Parts, client: Client, plant: str, folder: Path, generations: int) -> Decisions:
    """Registers a plant with two versions, and records decisions between them.

    For each generation that the pointer may reach there is a decision from either to the other.
    """
    client.register_plant(plant_document(plant))
    client.upload_episode(
        plant, save(folder, f"{plant}.mcap", episode_bytes(9, 60, role=Role.VALIDATION))
    )
    candidate = identified(plant, 1.2)
    client.add_artifact(plant, candidate.manifest)
    gate, episode = client.declare_gate(plant)["digest"], next(client.episodes(plant))["digest"]
    versions = [a["digest"] for a in client.artifacts(plant)]
    recorded = {}
    with writing(parts.database) as tx:
        for generation in range(1, generations + 1):
            for incumbent, other in (versions, versions[::-1]):
                document: dict[str, Any] = {
                    "gate": gate,
                    "candidate": other,
                    "incumbent": incumbent,
                    "generation": generation,
                }
                document |= {"accepted": True, "episodes": [episode], "figures": {}, "verdicts": []}
                context = ActorContext("bench", "2026-01-01T00:00:00.000000Z")
                recorded[generation, incumbent] = record_decision(
                    tx, plant, document, None, context
                ).digest
    return recorded


def run(
    urls: Sequence[str],
    token: str,
    plant: str,
    decisions: Decisions,
    threads: int,
    operations: int,
    seed: int,
) -> list[Operation]:
    """Reads, rolls back and promotes in many threads, at random servers. Returns the operations."""
    history: list[Operation] = []
    start = threading.Barrier(threads)

    def use(n: int) -> None:
        rng = random.Random(seed * 1000 + n)
        clients = [Client(url, token=token) for url in urls]
        start.wait()
        history.extend(
            _operate(rng.choice(clients), plant, decisions, rng) for _ in range(operations)
        )
        for client in clients:
            client.close()

    users = [threading.Thread(target=use, args=(n,)) for n in range(threads)]
    for user in users:
        user.start()
    for user in users:
        user.join()
    return history


def _operate(client: Client, plant: str, decisions: Decisions, rng: random.Random) -> Operation:
    kind = rng.choices(("read", "promote", "rollback"), (0.6, 0.2, 0.2))[0]
    began = time.monotonic()
    try:
        shown = _act(client, plant, decisions, kind)
    except Problem as refused:
        if refused.status >= 500:
            raise
        return Operation(kind, began, time.monotonic(), None, None)
    return Operation(kind, began, time.monotonic(), shown.generation, shown.artifact)


def _act(client: Client, plant: str, decisions: Decisions, kind: str) -> Serving:
    now = client.serving(plant)
    if kind == "read":
        return now
    if kind == "rollback":
        return client.roll_back(plant, now.generation)
    return client.promote(
        plant, decisions.get((now.generation, now.artifact), "0" * 64), now.generation
    )


def violations(operations: Sequence[Operation], logged: Sequence[Serving]) -> list[str]:
    """Returns what no single register could have shown, given the positions in the log."""
    by_generation = {s.generation: s.artifact for s in logged}
    shown = [o for o in operations if o.generation is not None]
    wrong = [
        f"generation {o.generation} was shown as {o.artifact}"
        for o in shown
        if by_generation.get(o.generation or 0) != o.artifact
    ]
    moves = [o.generation for o in shown if o.kind != "read"]
    wrong += [f"generation {g} was taken twice" for g in set(moves) if moves.count(g) > 1]
    latest, ended = 0, sorted(shown, key=lambda o: o.ended)
    index = 0
    for operation in sorted(shown, key=lambda o: o.began):
        while index < len(ended) and ended[index].ended < operation.began:
            latest = max(latest, ended[index].generation or 0)
            index += 1
        least = latest + (operation.kind != "read")
        if (operation.generation or 0) < least:
            wrong.append(
                f"a {operation.kind} showed generation {operation.generation} after {latest} "
                "had been shown"
            )
    return wrong
