"""Start, memory at rest, environment, the client's import, and uploads of 16 MiB beside a raw
write."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.generator import run, send
from bench.report import Figure, show
from bench.servers import ROOT, ours, resident_mib

MIB = 1 << 20
UPLOAD, ROUNDS = 16 * MIB, 9


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        with ours(Path(folder) / "ours") as (_, _, first):
            pass
        starts = []
        for _ in range(5):
            with ours(Path(folder) / "ours") as (port, child, seconds):
                starts.append(seconds)
                time.sleep(1.0)
                rest = resident_mib(child.pid)
                upload, raw = _uploads(port, Path(folder)) if len(starts) == 5 else (0.0, 1.0)
    start, client, environment = float(np.median(starts)), _client_import(), _environment_mib()
    show(
        "footprint: the server process, embedded storage",
        [
            Figure("start to first 200, median of 5", f"{start:.2f} s", "<= 1.5 s", start <= 1.5),
            Figure("… with an empty folder, migrations included", f"{first:.2f} s"),
            Figure("memory at rest", f"{rest:.0f} MiB", "<= 120 MiB", rest <= 120),
            Figure(
                "environment of server and worker",
                f"{environment:.0f} MiB",
                "<= 800 MiB",
                environment <= 800,
            ),
            Figure(
                "import of the robot's client, median of 9",
                f"{client:.3f} s",
                "<= 0.2 s",
                client <= 0.2,
            ),
            Figure(
                "upload of 16 MiB, verified and durable, median of 9",
                f"{upload:.0f} MiB/s",
                ">= 300 MiB/s",
                upload >= 300,
            ),
            Figure(
                "… beside a raw write and sync of the same bytes to a new file",
                f"{upload / raw:.2f} x",
            ),
        ],
    )


def _uploads(port: int, folder: Path) -> tuple[float, float]:
    """MiB/s of uploads and of raw writes, in turns."""
    sent, written = [], []
    for _ in range(ROUNDS):
        data = os.urandom(UPLOAD)
        request = send(
            "PUT", f"/v1/blobs/{hashlib.sha256(data).hexdigest()}", data, "application/octet-stream"
        )
        load = run(port, [iter([request])], 60.0)
        assert load.statuses == {201: 1}
        sent.append(load.latencies[0])
        began = time.perf_counter()
        with (folder / f"raw-{len(written)}").open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        written.append(time.perf_counter() - began)
    return tuple(UPLOAD / MIB / float(np.median(x)) for x in (sent, written))  # type: ignore[return-value]


def _client_import() -> float:
    bare, loaded = (
        float(np.median([_seconds(code) for _ in range(9)]))
        for code in ("pass", "import trueup_client")
    )
    return loaded - bare


def _seconds(code: str) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    return time.perf_counter() - began


def _environment_mib() -> float:
    """Installed size of what server and worker need, in an environment without the tests'
    packages."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", f"{folder}/v"], check=True)
        command = [
            str(ROOT / ".venv/bin/uv"),
            "pip",
            "install",
            "--quiet",
            "--link-mode",
            "copy",
            "--python",
            f"{folder}/v/bin/python",
            "--require-hashes",
            "-r",
            str(ROOT / "requirements.txt"),
        ]
        subprocess.run(command, check=True)
        return int(
            subprocess.run(
                ["du", "-sm", f"{folder}/v"], capture_output=True, text=True, check=True
            ).stdout.split()[0]
        )
