"""Inspect an upload in a process of its own, with limits, that can be killed.

    python -m trueup_service.inspection FILE < {"plant": …, "limits": …}

The child walks the container, decodes the episode and prints what it is, or the error, as one JSON document. A batch of telemetry it writes
as MCAP first, beside the file.
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import orjson

from trueup.canonical import Json
from trueup.errors import BadEpisode, TrueupError
from trueup_service.errors import InspectionFailed

CHILD_CPU_MARGIN_S = 1


@dataclass(frozen=True, slots=True)
class Inspected:
    """What an upload holds."""

    digest: str
    role: str
    start_ns: int
    end_ns: int
    summary: dict[str, Json]


@dataclass(frozen=True, slots=True)
class Against:
    """What an upload is held against: the plant's description, and where the model that serves was fitted, as its manifest tells."""

    plant: dict[str, Json]
    coverage: list[Json]


async def inspect_upload(path: Path, against: Against, memory_bytes: int, timeout_s: float, *, telemetry: bool = False) -> Inspected:
    """What the file holds as an episode of a plant; a batch of telemetry becomes the MCAP file `as_mcap(path)`.

    Raises BadEpisode with the child's code and facts, InspectionFailed at a limit.
    """
    child = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "trueup_service.inspection",
        str(path),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # a pool for each core would eat the address space
    )
    request = orjson.dumps(
        {**asdict(against), "telemetry": telemetry, "memory_bytes": memory_bytes, "cpu_s": int(timeout_s) + CHILD_CPU_MARGIN_S}
    )
    try:
        out, err = await asyncio.wait_for(child.communicate(request), timeout_s)
    except TimeoutError as error:
        raise InspectionFailed(f"the inspection took longer than {timeout_s:g} s", limit="inspection_timeout_s") from error
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    return _answer(out, err, child.returncode)


def _answer(out: bytes, err: bytes, code: int | None) -> Inspected:
    try:
        answer = orjson.loads(out)
    except orjson.JSONDecodeError as error:
        said = err.decode(errors="replace")
        limit = "inspection_memory_bytes" if "MemoryError" in said or (code or 0) < 0 else "none"
        raise InspectionFailed(f"the inspection ended with code {code}", limit=limit, detail=said[-200:]) from error
    if "problem" in answer:
        problem = answer["problem"]
        refused = BadEpisode(problem["message"], hint=problem["hint"], **problem["facts"])
        refused.code = problem["code"]
        raise refused
    return Inspected(**answer)


def as_mcap(path: Path) -> Path:
    """Where a batch of telemetry becomes an episode."""
    return path.with_suffix(".mcap")


def convert_file(path: Path, plant: dict[str, Json]) -> Path:
    """A batch of telemetry as an MCAP file beside it. Raises BadEpisode, BadPlant."""
    from trueup.episode.telemetry import telemetry_to_mcap  # noqa: PLC0415
    from trueup.model.plant import Plant  # noqa: PLC0415

    with as_mcap(path).open("xb") as file:
        telemetry_to_mcap(path.read_bytes(), Plant.from_document(plant).layout, file)
    return as_mcap(path)


def inspect_file(path: Path, against: Against) -> Inspected:
    """The same in this process, without limits. Raises BadEpisode, BadPlant."""
    from trueup.collect.coverage import Coverage  # noqa: PLC0415
    from trueup.collect.measured import measured  # noqa: PLC0415
    from trueup.episode.mcap import read_episode_stream  # noqa: PLC0415  (numpy: the server that waits for the child needs none)
    from trueup.episode.summary import summarise  # noqa: PLC0415
    from trueup.model.plant import Plant  # noqa: PLC0415

    described = Plant.from_document(against.plant)
    with path.open("rb") as file:
        episode = read_episode_stream(file, path.stat().st_size, described.layout)
    end_ns = episode.start_ns + round(float(episode.t_s[-1]) * 1e9)
    fitted_on = [Coverage.from_document(c) for c in against.coverage]  # type: ignore[arg-type]
    summary = {**summarise(episode), "collection": measured(described, episode, fitted_on)}
    return Inspected(episode.digest, str(episode.role), episode.start_ns, end_ns, summary)


def main() -> None:
    """The child."""
    request = json.load(sys.stdin)
    resource.setrlimit(resource.RLIMIT_AS, (request["memory_bytes"],) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (request["cpu_s"],) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        path = Path(sys.argv[1])
        held = convert_file(path, request["plant"]) if request["telemetry"] else path
        answer: object = asdict(inspect_file(held, Against(request["plant"], request["coverage"])))
    except TrueupError as error:
        answer = {"problem": {"code": error.code, "message": error.message, "hint": error.hint, "facts": error.facts}}
    sys.stdout.buffer.write(orjson.dumps(answer))


if __name__ == "__main__":
    main()
