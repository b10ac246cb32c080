"""Workers help one diagnosis; one of them is killed at it, and the report is that of the command,
bit for bit."""

import json

import pytest

from tests.flow.test_failures import until
from tests.support.case import write_recordings
from tests.support.service import Service, kill
from tests.support.simulated import recorded_twice as recorded
from trueup.diagnose.diagnosis import diagnose
from trueup.episode.mcap import read_episode
from trueup_client import Client
from trueup_worker.fan_out import PREFIX

KILLED = 2  # one of two workers is killed once so many batches were helped with


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A plant, its recordings, and the report of the library."""
    plant, episodes, _ = recorded("A1", ["quadratic_drag"], 21)
    files = write_recordings(tmp_path_factory.mktemp("recordings"), episodes)
    return (
        plant,
        files,
        diagnose(plant, [read_episode(file.read_bytes(), plant.layout) for file in files]),
    )


def test_the_report_is_the_same_whoever_helped_and_died(alone, storage, capfd):
    plant, files, expected = alone
    service, heard = Service(storage, log_level="INFO", job_poll_interval_s=0.1), []

    def helped(often):
        heard.extend(line for line in capfd.readouterr().err.splitlines() if '"helped"' in line)
        return len(heard) >= often

    with service.running(worker=False):
        workers = [service.start_worker() for _ in range(2)]
        client = Client(service.url, actor="tester")
        client.register_plant(dict(plant.document))
        for file in files:
            client.upload_episode(plant.name, file)
        job = client.submit(plant.name, {"kind": "diagnose"})["id"]
        until(lambda: helped(KILLED))
        kill(workers.pop())
        assert client.job(job)["result"] is None  # it died at it
        done = client.wait(job)
        client.close()
    assert done["state"] == "succeeded", done
    assert done["result"]["report"] == json.loads(json.dumps(dict(expected.document)))
    parts = storage.build()
    assert not parts.queue.names(PREFIX)
    parts.close()
