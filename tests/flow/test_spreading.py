"""Parts of a job have the same answers whichever workers compute them, and die while doing so."""

import json

import pytest

from tests.flow.test_failures import until
from tests.support.case import write_recordings
from tests.support.service import Service, kill
from tests.support.simulated import recorded_twice
from trueup.control.courses import Courses, Travelled
from trueup.control.machine import machine_of
from trueup.control.regimes import Conditions, run_regimes
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.model.predictor import Nominal
from trueup_client import Client
from trueup_service.jobs import PART_PREFIX, PARTS

SEEDS = [0, 1]
TICKS = 60


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    plant, episodes, _ = recorded_twice("A1", ["quadratic_drag"], 21)
    return plant, write_recordings(tmp_path_factory.mktemp("recordings"), episodes)


def entries(parts, status):
    return parts.queue._client.list_workflows(
        workflow_id_prefix=PART_PREFIX, status=status, load_input=False, load_output=False
    )


def test_a_worker_that_dies_at_a_part_changes_no_answer(machine, storage):
    plant, files = machine
    service, parts = Service(storage, job_poll_interval_s=0.1), storage.build()
    with service.running(worker=False), Client(service.url, actor="tester") as client:
        workers = {f"{child.pid}": child for child in (service.start_worker() for _ in range(2))}
        client.register_plant(dict(plant.document))
        for file in files:
            client.upload_episode(plant.name, file)
        nominal = client.serving(plant.name).artifact
        job = client.submit(
            plant.name,
            {
                "kind": "closedloop",
                "versions": [nominal],
                "machine": nominal,
                "regimes": ["nominal", "delayed", "reduced_authority"],
                "seeds": SEEDS,
                "ticks": TICKS,
            },
        )["id"]
        begun = until(lambda: entries(parts, "PENDING"))
        owner = begun[0].executor_id.split("-")[-2]
        kill(workers.pop(owner))
        done = client.wait(job)
    assert done["state"] == "succeeded", done
    assert {w.queue_name for w in begun} == {PARTS}
    assert not parts.queue.names(PART_PREFIX)
    parts.close()
    episodes = [read_episode(file.read_bytes(), plant.layout) for file in files]
    adaptation = [e for e in episodes if e.role is Role.ADAPTATION]
    expected = run_regimes(
        ("v1 nominal", machine_of(Nominal(plant))),
        {"v1 nominal": Nominal(plant)},
        Courses.within(plant, Travelled.of(plant, adaptation), TICKS, None),
        Conditions(("nominal", "delayed", "reduced_authority"), tuple(SEEDS)),
    )
    regimes = [
        {**r, "models": [{k: v for k, v in m.items() if k != "drawn"} for m in r["models"]]}
        for r in json.loads(json.dumps(expected))["regimes"]
    ]
    assert done["result"]["report"]["regimes"] == regimes
