"""The process that inspects uploads: it loads what inspections need once, and forks a child for
each.

    python -m trueup_service.inspector < SOCKET

Standard input is a socket. Each message on it brings another socket, from which the child reads
requests, each as a length and that many bytes of JSON, and on which it replies in the same way. A
child that meets a limit, or whose caller hangs up, dies alone. Telemetry, and what is of another
format, is first written as an MCAP file beside the received one.
"""

from __future__ import annotations

import gc
import json
import os
import queue
import resource
import signal
import socket
import struct
import sys
import tempfile
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import orjson

from trueup.artifact.artifact import Artifact, nominal_artifact, unpack
from trueup.canonical import Json
from trueup.collect.coverage import Coverage
from trueup.collect.measured import measured
from trueup.episode.mcap import read_episode_stream
from trueup.episode.role import Role
from trueup.episode.summary import summarise
from trueup.episode.telemetry import telemetry_to_mcap
from trueup.episode.writer import write_episode
from trueup.errors import TrueupError
from trueup.model.plant import Plant
from trueup.recording.described import Described
from trueup.recording.received import as_episode
from trueup_service.inspection import LENGTH, Inspected, PlantContext, mcap_path

KINDS = {"manifest": "artifact", "draft": "draft"}  # of requests, by what one holds
REHEARSED_SAMPLES = 200
REHEARSED: dict[str, Json] = {
    "name": "rehearsal",
    "nominal": {
        "family": "oscillator",
        "parameters": {"k": 1.0, "c": 1.0, "b": 1.0},
        "timestep_s": 0.01,
    },
    "commands": [{"name": "u", "unit": "1", "limits": [-1.0, 1.0]}],
    "observations": [{"name": "q", "unit": "rad"}],
    "evaluation": {"horizon_s": 1.0},
}


def inspect_file(path: Path, against: PlantContext) -> Inspected:
    """Inspect a file as an episode of a plant. Raises BadEpisode, BadPlant."""
    described = Plant.from_document(against.plant)
    with path.open("rb") as file:
        episode = read_episode_stream(file, path.stat().st_size, described.layout)
    end_ns = episode.start_ns + round(float(episode.t_s[-1]) * 1e9)
    fitted_on = [Coverage.from_document(c) for c in against.coverage]  # type: ignore[arg-type]
    summary = {**summarise(episode), "collection": measured(described, episode, fitted_on)}
    return Inspected(
        episode.digest, str(episode.role), episode.start_ns, end_ns, summary, episode.samples_digest
    )


def episode_file(path: Path, plant: dict[str, Json], described: dict[str, Any]) -> Path:
    """The file of the episode that a received file is, or that is written beside it. Raises
    BadEpisode, BadMapping, BadPlant."""
    layout = Plant.from_document(plant).layout
    return as_episode(path, layout, Described(**described), mcap_path(path))


def convert_file(path: Path, plant: dict[str, Json]) -> Path:
    """Write a batch of telemetry as an MCAP file beside it, and return its path. Raises BadEpisode,
    BadPlant."""
    with mcap_path(path).open("xb") as file:
        telemetry_to_mcap(path.read_bytes(), Plant.from_document(plant).layout, file)
    return mcap_path(path)


def try_artifact(manifest: bytes, arrays: Path | None) -> None:
    """Load an artifact and let it answer its probe. Raises BadArtifact, BadPlant."""
    unpack(Artifact(manifest, b"" if arrays is None else arrays.read_bytes()))


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """The reply to a request: what its file holds, the problem with it, or that memory was too
    small."""
    of = next((of for key, of in KINDS.items() if key in request), "episode")
    try:
        if of == "draft":
            return {"draft": _draft(**request["draft"])}
        if of == "artifact":
            try_artifact(
                request["manifest"].encode(),
                None if request["arrays"] is None else Path(request["arrays"]),
            )
            return {}
        path = Path(request["path"])
        held = path
        if request["telemetry"]:
            held = convert_file(path, request["plant"])
        elif request["described"] is not None:
            held = episode_file(path, request["plant"], request["described"])
        return asdict(inspect_file(held, PlantContext(request["plant"], request["coverage"])))
    except TrueupError as error:
        return {
            "problem": {
                "of": of,
                "code": error.code,
                "message": error.message,
                "hint": error.hint,
                "facts": error.facts,
            }
        }
    except MemoryError:
        return {"limit": "inspection_memory_bytes"}


def _draft(received: str, out: str, wishes: dict[str, Any]) -> dict[str, Json]:
    from trueup.diagnose.draft import Wishes, draft_of  # noqa: PLC0415  (most children inspect)

    return draft_of(Path(received), Path(out), Wishes(**wishes))


def _child(asked: socket.socket) -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(asked, requests), daemon=True).start()
    while True:
        request = json.loads(requests.get())
        used = resource.getrusage(resource.RUSAGE_SELF)
        until_s = int(used.ru_utime + used.ru_stime) + request["cpu_s"]
        resource.setrlimit(resource.RLIMIT_AS, (request["memory_bytes"],) * 2)
        resource.setrlimit(resource.RLIMIT_CPU, (until_s, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        reply = orjson.dumps(answer(request))
        asked.sendall(struct.pack(LENGTH, len(reply)) + reply)


def _listen(asked: socket.socket, requests: queue.SimpleQueue[bytes]) -> None:
    """Takes requests until the caller hangs up, which ends what is being answered."""
    while True:
        (length,) = struct.unpack(LENGTH, _exactly(asked, struct.calcsize(LENGTH)))
        requests.put(_exactly(asked, length))


def _exactly(asked: socket.socket, count: int) -> bytes:
    """So many bytes. The process ends where the caller is gone."""
    data = b""
    while len(data) < count:
        try:
            part = asked.recv(min(count - len(data), 1 << 20))
        except OSError:
            part = b""
        if not part:
            os._exit(0)
        data += part
    return data


def rehearse() -> None:
    """Inspect a small episode, so that what is loaded on first use is loaded here and not in every
    child."""
    plant = Plant.from_document(REHEARSED)
    t, one = np.arange(REHEARSED_SAMPLES), np.ones((REHEARSED_SAMPLES, 1))
    with (
        tempfile.TemporaryDirectory() as folder,
        (path := Path(folder) / "small.mcap").open("w+b") as file,
    ):
        write_episode(
            file,
            stamps_ns=t * 10**7,
            observations=np.sin(0.01 * t)[:, None],
            commands=one,
            layout=plant.layout,
            role=Role.TELEMETRY,
            conditions={},
        )
        file.flush()
        inspect_file(path, PlantContext(dict(plant.document), []))
    nominal = nominal_artifact(plant)
    try_artifact(nominal.manifest, None)
    gc.collect()
    gc.freeze()  # keeps a child's collector from touching the memory that it shares


def main() -> None:
    """Fork children until the process that started this one is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server decides when this process ends
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # no child is waited for
    rehearse()
    with socket.socket(fileno=sys.stdin.fileno()) as control:
        while True:
            message, handles, _, _ = socket.recv_fds(control, 1, 1)
            if not message:
                return
            if os.fork() == 0:
                control.close()
                _in_child(handles[0])
            for handle in handles:
                os.close(handle)


def _in_child(handle: int) -> NoReturn:
    code = 1
    try:
        with socket.socket(fileno=handle) as asked:
            _child(asked)
        code = 0
    except BrokenPipeError:
        code = 0  # the caller is gone
    except Exception:  # noqa: BLE001  (it is reported, and the process ends)
        sys.excepthook(*sys.exc_info())
    finally:
        os._exit(code)


if __name__ == "__main__":
    main()
