"""Ingest of a recording of about 100 MB, beside decoding it with the stock Python reader; and what
the server's memory does meanwhile."""

from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType

from bench.report import Figure, show
from bench.servers import ours, resident_mib
from tests.support.made import arm_layout, plant_document
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup_client import Client

JOINTS, SAMPLES, ROUNDS = 7, 150_000, 3


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, ours(Path(folder) / "ours") as (port, child, _):
        path = Path(folder) / "arm.mcap"
        _write(path)
        size = path.stat().st_size / 1e6
        client = Client(f"http://127.0.0.1:{port}", timeout_s=300)
        document = plant_document("arm-joint")
        document["observations"] = [dict(o, joint="j3") for o in document["observations"]]
        document["commands"] = [dict(document["commands"][0], joint="j3")]
        client.register_plant(document)
        before, peak, stop = resident_mib(child.pid), [0.0], threading.Event()
        watcher = threading.Thread(target=_watch, args=(child.pid, peak, stop))
        watcher.start()
        pairs = []
        for n in range(ROUNDS):
            began = time.perf_counter()
            client.upload_episode("arm-joint", path)
            ingest = time.perf_counter() - began
            pairs.append((ingest, _stock(path)))
            _write(path, seed=n + 1)  # other bytes: the same ones would be known already
        stop.set()
        watcher.join()
        client.close()
    ingest, stock = (float(np.median([p[i] for p in pairs])) for i in (0, 1))
    grown = peak[0] - before
    show(
        f"ingest: {size:.0f} MB MCAP, {2 * SAMPLES} messages of {JOINTS} joints as ROS 2 CDR "
        "in chunks, "
        f"over HTTP, verified, inspected, durable; median of {ROUNDS}",
        [
            Figure(
                "ingest beside decoding with the stock reader",
                f"{stock / ingest:.1f} x",
                ">= 5 x",
                stock / ingest >= 5,
            ),
            Figure("ingest", f"{ingest:.2f} s, {size / ingest:.0f} MB/s"),
            Figure("server memory grows by", f"{grown:.1f} MiB", "< 64 MiB", grown < 64),
        ],
    )


def _write(path: Path, seed: int = 0) -> None:
    rng, layout = np.random.default_rng(seed), arm_layout(JOINTS)
    stamps = 1_760_000_000_000_000_000 + np.arange(SAMPLES) * 2_000_000
    with path.open("wb") as stream:
        write_episode(
            stream,
            stamps_ns=stamps,
            observations=rng.normal(size=(SAMPLES, 2 * JOINTS)),
            commands=rng.uniform(-1, 1, (SAMPLES, JOINTS)),
            layout=layout,
            role=Role.ADAPTATION,
            conditions={},
            compression=CompressionType.NONE,
        )


def _stock(path: Path) -> float:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    began = time.perf_counter()
    with path.open("rb") as stream:
        count = sum(
            1
            for _ in make_reader(
                stream, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        )
    assert count == 2 * SAMPLES
    return time.perf_counter() - began


def _watch(pid: int, peak: list[float], stop: threading.Event) -> None:
    while not stop.wait(0.01):
        peak[0] = max(peak[0], resident_mib(pid))
