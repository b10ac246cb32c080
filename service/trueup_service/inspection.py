"""Inspection of uploads in a process of their own with limits, a child of the inspector, which has
loaded what inspections need.

The server does not read recordings or arrays into its own memory. The number of inspections at once
and the memory limit of each bound what all of them take.
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
from trueup.errors import BadArtifact, BadEpisode, BadPlant, TrueupError
from trueup.recording.described import Described
from trueup_service.errors import InspectionFailed

LENGTH = "!Q"  # of a request or a reply, in front of it
QUESTIONS = 200  # that one child answers about manifests, which are small
CPU_MARGIN_S = 1
REFUSALS: dict[str, type[TrueupError]] = {
    "episode": BadEpisode,
    "artifact": BadArtifact,
    "draft": BadPlant,
}
ENDING_S = 5.0  # for the inspector to end by itself [s]


@dataclass(frozen=True, slots=True)
class Inspected:
    """What an inspected recording holds."""

    digest: str
    role: str
    start_ns: int
    end_ns: int
    summary: dict[str, Json]
    samples_digest: str | None


@dataclass(frozen=True, slots=True)
class PlantContext:
    """What a recording of a plant is inspected against: the plant's description, and the coverage
    on which the model that serves was fitted, from its manifest."""

    plant: dict[str, Json]
    coverage: list[Json]


def mcap_path(path: Path) -> Path:
    """The path at which a batch of telemetry, or a file of another format, becomes an MCAP
    file."""
    return path.with_suffix(".mcap")


@dataclass(slots=True)
class _Child:
    """A child of the inspector, and how often it was asked."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    asked: int = 0

    async def ask(self, request: bytes) -> bytes:
        """Its reply. Raises OSError, IncompleteReadError where it dies."""
        self.asked += 1
        self.writer.write(struct.pack(LENGTH, len(request)) + request)
        (length,) = struct.unpack(LENGTH, await self.reader.readexactly(struct.calcsize(LENGTH)))
        return await self.reader.readexactly(length)


class Inspector:
    """Inspects uploads, up to a number at once. Its process is started with the first inspection,
    and again where it died."""

    def __init__(self, at_once: int, memory_bytes: int, timeout_s: float) -> None:
        self._slots = asyncio.Semaphore(at_once)
        self._memory_bytes, self._timeout_s = memory_bytes, timeout_s
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None
        self._kept: list[_Child] = []

    async def inspect(
        self,
        path: Path,
        against: PlantContext,
        *,
        described: Described | None = None,
        telemetry: bool = False,
    ) -> Inspected:
        """Inspect a file as an episode of a plant. A batch of telemetry, and a file of another
        format, becomes the MCAP file `mcap_path(path)`.

        Raises BadEpisode with the child's code and facts, and InspectionFailed at a limit.
        """
        request: dict[str, Json] = {
            **asdict(against),
            "path": str(path.absolute()),
            "telemetry": telemetry,
            "described": None if described is None else asdict(described),
        }
        return Inspected(**await self._reply(request))

    async def try_artifact(self, manifest: bytes, arrays: Path | None) -> None:
        """Load an artifact from its manifest and the file of its arrays, and let it answer its
        probe.

        Raises BadArtifact with the child's code and facts, and InspectionFailed at a limit.
        """
        await self._reply(
            {
                "manifest": manifest.decode(),
                "arrays": None if arrays is None else str(arrays.absolute()),
            },
            small=arrays is None,
        )

    async def draft(self, received: Path, out: Path, wishes: dict[str, Json]) -> dict[str, Json]:
        """The plant and the episodes that a received file proposes (`trueup.diagnose.draft`), under
        these wishes; the episodes are written into the folder `out`.

        Raises BadPlant with the child's code and facts, and InspectionFailed at a limit.
        """
        paths: dict[str, Json] = {"received": str(received.absolute()), "out": str(out.absolute())}
        reply = await self._reply({"draft": {**paths, "wishes": wishes}})
        draft: dict[str, Json] = reply["draft"]
        return draft

    async def _reply(self, question: Mapping[str, Json], *, small: bool = False) -> dict[str, Any]:
        """The reply of a child of the inspector to a request. Raises what `inspect` raises.

        A child that answered a small request well is kept for the next small one, since to fork one
        takes longer than to answer.
        """
        limits = {"memory_bytes": self._memory_bytes, "cpu_s": int(self._timeout_s) + CPU_MARGIN_S}
        request = orjson.dumps({**question, **limits})
        async with self._slots:
            child = (self._kept.pop() if small and self._kept else None) or await self._new_child()
            reply = None
            try:
                reply = await asyncio.wait_for(child.ask(request), self._timeout_s)
            except TimeoutError as error:
                raise InspectionFailed(
                    f"the inspection took longer than {self._timeout_s:g} s",
                    limit="inspection_timeout_s",
                ) from error
            except (OSError, asyncio.IncompleteReadError):
                reply = b""  # the child died
            finally:
                if small and reply and child.asked < QUESTIONS:
                    self._kept.append(child)
                else:
                    child.writer.close()  # a child that still works on it dies then
        return _parsed(reply)

    async def _new_child(self) -> _Child:
        return _Child(*await asyncio.open_connection(sock=self._connection()))

    def close(self) -> None:
        """End the inspector's process and its children."""
        for child in self._kept:
            child.writer.close()
        self._kept.clear()
        if self._process is not None and self._control is not None:
            self._control.close()
            try:
                self._process.wait(ENDING_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._process = self._control = None

    def _connection(self) -> socket.socket:
        """A connection to a new child of the inspector."""
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                socket.send_fds(self._started(), [b"?"], [theirs.fileno()])
            except OSError:  # the inspector died: start another one
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
                    },  # a thread pool for each core would use up the address space
                )
        return self._control


def _parsed(answer: bytes) -> dict[str, Any]:
    try:
        reply = orjson.loads(answer)
    except orjson.JSONDecodeError as error:
        raise InspectionFailed(
            "the inspection died of what it read", limit="inspection_memory_bytes"
        ) from error
    if "limit" in reply:
        raise InspectionFailed("the inspection met a limit", limit=reply["limit"])
    if "problem" in reply:
        problem = reply["problem"]
        refused = REFUSALS[problem["of"]](
            problem["message"], hint=problem["hint"], **problem["facts"]
        )
        refused.code = problem["code"]
        raise refused
    return dict(reply)
