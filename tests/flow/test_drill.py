"""A drill backs up and restores while the service runs, and finds what a restore would not bring
back."""

import json
import os
import threading

import pytest

from tests.support.forks import run
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import ROOT, Service
from tests.support.tampering import promoted
from trueup.errors import TrueupError
from trueup_client import Client
from trueup_service import drill as module
from trueup_service.drill import drill
from trueup_service.signed_log import open_log

NOW = "2027-01-01T00:00:00.000000Z"


def fsck(storage, *arguments):
    environment = {**os.environ, **storage.environment, "COLUMNS": "200", "NO_COLOR": "1"}
    return run("trueup_cli.main", ["fsck", "--drill", *arguments], environment, ROOT)


def test_it_runs_beside_a_service_that_takes_uploads_and_leaves_nothing(storage, tmp_path):
    service, within = Service(storage), tmp_path / "room"
    within.mkdir()
    with service.running(), Client(service.url) as client:
        promoted(client, tmp_path)
        service.stop(service.workers)
        waiting = client.submit("p", {"kind": "fit", "method": "identify"})
        stop, uploaded = threading.Event(), []

        def keep_uploading():
            with Client(service.url) as other:
                seed = 10
                while not stop.is_set():
                    data = episode_bytes(seed, samples=50)
                    uploaded.append(
                        other.upload_episode("p", save(tmp_path, f"{seed}.mcap", data))["digest"]
                    )
                    seed += 1

        uploading = threading.Thread(target=keep_uploading)
        uploading.start()
        try:
            done = fsck(storage, "--drill-in", str(within), "--json")
        finally:
            stop.set()
            uploading.join()
        assert done.returncode == 0, done.stderr
        said = json.loads(done.stdout)
        assert said["findings"] == said["drill"]["findings"] == []
        assert said["drill"]["jobs"] == 1
        assert said["drill"]["entries"] >= said["entries"]
        assert uploaded
        assert list(within.iterdir()) == []
        assert client.job(waiting["id"])["state"] == "queued"  # the copy's jobs are its own
        said = fsck(storage).stdout
        assert "the drill backed up in" in said


@pytest.fixture
def parts(storage, tmp_path):
    service = Service(storage)
    with service.running(worker=False), Client(service.url) as client:
        client.register_plant(plant_document("p"))
        client.upload_episode("p", save(tmp_path, "a.mcap", episode_bytes()))
    parts = storage.build()
    yield parts
    parts.close()


def test_what_a_restore_loses_is_found(parts, monkeypatch):
    restore = module.restore

    def forgetful(restored, archive, progress):
        jobs = restore(restored, archive, progress)
        with restored.database.write() as connection:
            connection.exec_driver_sql("DELETE FROM episodes")
        return jobs

    monkeypatch.setattr(module, "restore", forgetful)
    done = drill(parts, open_log(parts.settings, parts.database), None, NOW, lambda *_: None)
    assert [f.what for f in done.findings if "episodes/p/" in f.where]


def test_a_blob_that_is_damaged_is_found_before_anything_is_restored(parts, monkeypatch):
    digest, kind = next(iter(parts.blobs.all())), type(parts.blobs)
    whole = b"".join(parts.blobs.stream(digest))
    damaged = whole[:-1] + bytes([whole[-1] ^ 1])
    stream = kind.stream
    monkeypatch.setattr(
        kind, "stream", lambda blobs, d: iter([damaged]) if d == digest else stream(blobs, d)
    )
    monkeypatch.setattr(module, "restore", lambda *_: pytest.fail("it was restored"))
    with pytest.raises(TrueupError, match=r"digest|not what|damaged"):
        drill(parts, open_log(parts.settings, parts.database), None, NOW, lambda *_: None)
