"""An upload is inspected by a process that may die of it, and nobody else does."""

import asyncio
import hashlib
import json
import os
import signal
import time
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from tests.support.made import episode_bytes, plant_document, save
from trueup.errors import BadEpisode
from trueup_service.errors import InspectionFailed
from trueup_service.inspection import Inspector, PlantContext, mcap_path

pytestmark = pytest.mark.slow  # each starts a process that loads what inspections need
HELD = PlantContext(plant_document("p"), [])
MEMORY = 1 << 30


@asynccontextmanager
async def inspecting(memory_bytes=MEMORY, timeout_s=60.0):
    found = Inspector(2, memory_bytes, timeout_s)
    try:
        yield found
    finally:
        found.close()


def of(inspector):
    """The inspector's process and its children."""
    pid = inspector._process.pid
    return pid, [
        int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    ]


@pytest.fixture
def sound(tmp_path):
    return save(tmp_path, "sound.mcap", episode_bytes(1, 200))


def test_many_are_inspected_by_children_of_one_process(sound):
    async def many():
        async with inspecting() as inspector:
            found = await asyncio.gather(*(inspector.inspect(sound, HELD) for _ in range(6)))
            return found, of(inspector)

    found, _ = asyncio.run(many())
    assert {f.digest for f in found} == {hashlib.sha256(sound.read_bytes()).hexdigest()}


def test_no_more_are_inspected_at_once_than_it_was_told(tmp_path):
    endless = tmp_path / "endless.mcap"
    os.mkfifo(endless)  # opening it for reading waits for a writer, for ever

    async def three():
        async with inspecting() as inspector:
            asked = [asyncio.create_task(inspector.inspect(endless, HELD)) for _ in range(3)]
            while inspector._process is None or len(of(inspector)[1]) < 2:
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.3)  # many times what another one needs to begin
            children = of(inspector)[1]
            for task in asked:
                task.cancel()
            await asyncio.gather(*asked, return_exceptions=True)
            return children

    assert len(asyncio.run(three())) == 2


def test_a_file_that_is_no_episode_is_told_with_its_code(tmp_path):
    async def one():
        async with inspecting() as inspector:
            await inspector.inspect(save(tmp_path, "bad.mcap", b"no MCAP at all"), HELD)

    with pytest.raises(BadEpisode) as refused:
        asyncio.run(one())
    assert refused.value.code == "malformed-mcap"


@pytest.mark.parametrize(
    ("limits", "limit"),
    [((64 << 20, 60.0), "inspection_memory_bytes"), ((MEMORY, 1e-4), "inspection_timeout_s")],
)
def test_a_limit_is_told(tmp_path, limits, limit):
    large = save(tmp_path, "large.mcap", episode_bytes(1, 20_000))

    async def one():
        async with inspecting(*limits) as inspector:
            await inspector.inspect(large, HELD)

    with pytest.raises(InspectionFailed) as failed:
        asyncio.run(one())
    assert failed.value.facts["limit"] == limit


def test_a_batch_of_telemetry_becomes_an_episode_beside_it(tmp_path):
    batch = {
        "start_ns": "1000000000",
        "t_s": [0.05 * i for i in range(60)],
        "observations": {
            c["name"]: [0.1 * i for i in range(60)] for c in plant_document("p")["observations"]
        },
        "commands": {c["name"]: [0.0] * 60 for c in plant_document("p")["commands"]},
    }
    path = save(tmp_path, "batch.json", json.dumps(batch).encode())

    async def one():
        async with inspecting() as inspector:
            return await inspector.inspect(path, HELD, telemetry=True)

    assert asyncio.run(one()).role == "telemetry"
    assert mcap_path(path).is_file()


def test_a_killed_inspector_is_started_again(sound):
    async def twice():
        async with inspecting() as inspector:
            first = await inspector.inspect(sound, HELD)
            before, _ = of(inspector)
            os.kill(before, signal.SIGKILL)
            inspector._process.wait()
            second = await inspector.inspect(sound, HELD)
            return first, second, before, of(inspector)[0]

    first, second, before, after = asyncio.run(twice())
    assert first == second
    assert before != after


def test_who_hangs_up_leaves_no_child_behind(tmp_path):
    endless = tmp_path / "endless.mcap"
    os.mkfifo(endless)  # opening it for reading waits for a writer, for ever

    async def leave():
        async with inspecting() as inspector:
            asked = asyncio.create_task(inspector.inspect(endless, HELD))
            began = time.monotonic()
            while inspector._process is None or not of(inspector)[1]:
                await asyncio.sleep(0.01)
            asked.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asked
            while of(inspector)[1]:
                assert time.monotonic() - began < 60.0
                await asyncio.sleep(0.01)

    asyncio.run(leave())
