"""Inspect an upload in a process of its own, with limits: a child of the inspector, which has
loaded what that needs.

No recording and no arrays are read into the server's own memory as they come in: so many
inspections at once, with so much memory each, bound what all of them take.
"""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import orjson

from trueup.canonical import Json
from trueup.errors import BadArtifact, BadEpisode, TrueupError
from trueup_service.errors import InspectionFailed

LENGTH = "!Q"  # before a request
CPU_MARGIN_S = 1
REFUSALS: dict[str, type[TrueupError]] = {"episode": BadEpisode, "artifact": BadArtifact}
ENDING_S = 5.0  # for the inspector to end by itself


@dataclass(frozen=True, slots=True)
class Inspected:
    """What an upload holds."""

    digest: str
    role: str
    start_ns: int
    end_ns: int
    summary: dict[str, Json]
    samples_digest: str | None


@dataclass(frozen=True, slots=True)
class PlantContext:
    """What an upload is held against: the plant's description, and where the model that serves was
    fitted, as its manifest tells."""

    plant: dict[str, Json]
    coverage: list[Json]


def mcap_path(path: Path) -> Path:
    """Where a batch of telemetry becomes an episode."""
    return path.with_suffix(".mcap")


class Inspector:
    """Inspects uploads, so many at once; its process is started when it is first asked, and again
    should it die."""

    def __init__(self, at_once: int, memory_bytes: int, timeout_s: float) -> None:
        self._slots = asyncio.Semaphore(at_once)
        self._memory_bytes, self._timeout_s = memory_bytes, timeout_s
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    async def inspect(
        self, path: Path, against: PlantContext, *, telemetry: bool = False
    ) -> Inspected:
        """What the file holds as an episode of a plant; a batch of telemetry becomes the MCAP file
        `mcap_path(path)`.

        Raises BadEpisode with the child's code and facts, InspectionFailed at a limit.
        """
        return Inspected(
            **await self._answer(
                {**asdict(against), "path": str(path.absolute()), "telemetry": telemetry}
            )
        )

    async def try_artifact(self, manifest: bytes, arrays: Path | None) -> None:
        """Load an artifact from its manifest and the file of its arrays, and have it answer its
        probe.

        Raises BadArtifact with the child's code and facts, InspectionFailed at a limit.
        """
        await self._answer(
            {
                "manifest": manifest.decode(),
                "arrays": None if arrays is None else str(arrays.absolute()),
            }
        )

    async def _answer(self, asked: Mapping[str, Json]) -> dict[str, Any]:
        """What a child says to a request."""
        limits = {"memory_bytes": self._memory_bytes, "cpu_s": int(self._timeout_s) + CPU_MARGIN_S}
        request = orjson.dumps({**asked, **limits})
        async with self._slots:
            reader, writer = await asyncio.open_connection(sock=self._child())
            try:
                writer.write(struct.pack(LENGTH, len(request)) + request)
                answer = await asyncio.wait_for(reader.read(), self._timeout_s)
            except TimeoutError as error:
                raise InspectionFailed(
                    f"the inspection took longer than {self._timeout_s:g} s",
                    limit="inspection_timeout_s",
                ) from error
            except OSError:
                answer = b""  # it died before it had read
            finally:
                writer.close()  # whoever still works on it dies of that
        return _told(answer)

    def close(self) -> None:
        """Let the process end."""
        if self._process is not None and self._control is not None:
            self._control.close()
            try:
                self._process.wait(ENDING_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._process = self._control = None

    def _child(self) -> socket.socket:
        """A connection to a fresh child of the inspector."""
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                socket.send_fds(self._started(), [b"?"], [theirs.fileno()])
            except OSError:  # it died: another one
                self.close()
                socket.send_fds(self._started(), [b"?"], [theirs.fileno()])
        return ours

    def _started(self) -> socket.socket:
        if self._control is None:
            self._control, theirs = socket.socketpair()
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "trueup_service.inspector"],
                    stdin=theirs.fileno(),
                    env={
                        **os.environ,
                        "OPENBLAS_NUM_THREADS": "1",
                    },  # a pool for each core would eat the address space
                )
        return self._control


def _told(answer: bytes) -> dict[str, Any]:
    try:
        found = orjson.loads(answer)
    except orjson.JSONDecodeError as error:
        raise InspectionFailed(
            "the inspection died of what it read", limit="inspection_memory_bytes"
        ) from error
    if "limit" in found:
        raise InspectionFailed("the inspection met a limit", limit=found["limit"])
    if "problem" in found:
        problem = found["problem"]
        refused = REFUSALS[problem["of"]](
            problem["message"], hint=problem["hint"], **problem["facts"]
        )
        refused.code = problem["code"]
        raise refused
    return dict(found)
