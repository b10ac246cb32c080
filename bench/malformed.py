"""Damaged recordings, bombs and other files: is each refused with a code within a second, and does
the server's memory stay?"""

from __future__ import annotations

import http.client
import io
import json
import os
import random
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import zstandard

from bench.report import Figure, show
from bench.servers import TOKEN, ours, resident_mib
from tests.support.conformance import MAGIC, variants
from tests.support.made import episode_bytes, plant_document
from trueup_client import Client

UPLOADS, SEED = int(os.environ.get("UPLOADS", "600")), 4
LIMIT_S, LIMIT_MIB = 1.0, 256


def main() -> None:
    rng = random.Random(SEED)
    with tempfile.TemporaryDirectory() as name, ours(Path(name)) as (port, child, _):
        with closing(Client(f"http://127.0.0.1:{port}", token=TOKEN)) as client:
            client.register_plant(plant_document("p"))
        _send(port, _damaged(rng, 0))
        before, most, seconds, wrong, good = resident_mib(child.pid), 0, [], [], 0
        for n in range(UPLOADS):
            body = _damaged(rng, n)
            began = time.perf_counter()
            status, answer = _send(port, body)
            seconds.append(time.perf_counter() - began)
            most = max(most, resident_mib(child.pid))
            good += status == 201
            if status != 201 and not (400 <= status < 500 and json.loads(answer).get("code")):
                wrong.append((n, status, answer[:80]))
    print(*wrong, sep="\n")
    grown = most - before
    slow = sum(s > LIMIT_S for s in seconds)
    p50, worst = np.median(seconds), max(seconds)
    figures = [
        Figure(
            f"malformed uploads not refused with 4xx and a code, of {UPLOADS - good}",
            str(len(wrong)),
            "0",
            not wrong,
        ),
        Figure(
            f"… answered later than {LIMIT_S:g} s; p50 {p50:.2f} s, worst {worst:.2f} s",
            str(slow),
            "0",
            not slow,
        ),
        Figure(
            "… server memory grows by", f"{grown:.0f} MiB", f"< {LIMIT_MIB} MiB", grown < LIMIT_MIB
        ),
    ]
    show("Malformed", figures)


def _send(port: int, body: bytes) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("POST", "/v1/plants/p/episodes", body, {"Authorization": f"Bearer {TOKEN}"})
    found = connection.getresponse()
    answer = found.status, found.read()
    connection.close()
    return answer


VARIANTS = [v.data for v in variants()]


def _damaged(rng: random.Random, n: int) -> bytes:
    """A file that is no episode: flipped, cut, doubled, grown, a bomb, another format, or sound
    MCAP of something else."""
    sound = episode_bytes(n % 20, 120)
    at = rng.randrange(9, len(sound) - 9)
    made = (
        lambda: _flipped(sound, rng, rng.randint(1, 40)),
        lambda: sound[:at],
        lambda: rng.choice(VARIANTS),
        lambda: sound[:at] + rng.randbytes(8) + sound[at:],
        lambda: _bomb(rng.choice((10**6, 10**8, 10**9))),
        lambda: rng.randbytes(rng.randrange(1, 10**5)),
        lambda: sound + sound,
        lambda: _flipped(rng.choice(VARIANTS), rng, 3),
    )
    return made[n % len(made)]()


def _flipped(data: bytes, rng: random.Random, times: int) -> bytes:
    found = bytearray(data)
    for _ in range(times):
        found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def _bomb(size: int) -> bytes:
    """A chunk that unfolds to far more than it says."""
    stream = io.BytesIO()
    with zstandard.ZstdCompressor(level=19).stream_writer(stream, closefd=False) as writer:
        for _ in range(size // 10**6):
            writer.write(bytes(10**6))
    packed = stream.getvalue()
    head = (
        (0).to_bytes(24, "little") + (0).to_bytes(4, "little") + (4).to_bytes(4, "little") + b"zstd"
    )
    chunk = (
        head[:16]
        + (1000).to_bytes(8, "little")
        + head[24:]
        + len(packed).to_bytes(8, "little")
        + packed
    )
    header = b"\1" + (8).to_bytes(8, "little") + bytes(8)
    return MAGIC + header + b"\6" + len(chunk).to_bytes(8, "little") + chunk + MAGIC
