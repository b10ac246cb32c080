"""A registry, or a plant of it, goes out as one file and comes in again, verified on the way by two
programs that share no line."""

import contextlib
import hashlib
import importlib.util
import io
import json
import os
import shutil
import socket
import subprocess
import sys
import tarfile
import uuid
from contextlib import closing

import pytest

from tests.flow.test_failures import until
from tests.support import forks
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import ROOT, Service, command, kill
from tests.support.storage import embedded, scaled
from tests.support.tampering import promoted
from trueup.episode.role import Role
from trueup.ledger.archive_layout import SIGNATURE, statement_of
from trueup.ledger.signed_note import Signer
from trueup_client import Client, Problem
from trueup_client.calls import plants
from trueup_service.actions.register_plant import register_plant
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord, JobState
from trueup_service.registry.transaction import reading, writing

CONTEXT = ActorContext("tester", "2026-01-01T00:00:00.000000Z")
VERIFIER = ROOT / "tools" / "verify_archive.py"


def run(storage, *arguments, check=True):
    """A command on the storage itself."""
    environment = {**os.environ, **storage.environment, "COLUMNS": "200", "NO_COLOR": "1"}
    done = forks.run("trueup_cli.main", [str(x) for x in arguments], environment, ROOT)
    assert not check or done.returncode == 0, done.stderr
    return done


def verified_here(archive, *key):
    """The same verifier in this process, for many archives."""
    spec = importlib.util.spec_from_file_location("verify_archive", VERIFIER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with contextlib.redirect_stdout(io.StringIO()):
        return module.main([str(archive), *key])


def verified(archive, *key):
    """What the one-file verifier says, run where none of our packages can be imported."""
    done = subprocess.run(
        [sys.executable, "-I", str(VERIFIER), str(archive), *key],
        capture_output=True,
        text=True,
        check=False,
        cwd=archive.parent,
    )
    return done.returncode, done.stdout


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def site(request, tmp_path_factory):
    """A site with a plant that was corrected, a second plant, and a job that nobody has begun."""
    folder = tmp_path_factory.mktemp("site")
    fixture = request.getfixturevalue
    storage = (
        embedded(folder / "data")
        if request.param == "embedded"
        else scaled(folder / "data", fixture("postgres"), fixture("s3"))
    )
    service = Service(storage)
    service.start_server()
    worker = service.start_worker()
    client = Client(service.url)
    candidate, decision = promoted(client, folder)
    client.register_plant(plant_document("other"))
    client.issue_token("secret", ["auditor"])
    compared = client.wait(
        client.submit(
            "p", {"kind": "compare", "first": client.version("p", 1)["digest"], "second": candidate}
        )["id"]
    )
    assert compared["state"] == "succeeded"  # and left files behind
    kill(worker)
    waiting = client.submit("p", {"kind": "fit", "method": "identify"})["id"]
    key = client.audit_key()
    yield storage, service, folder, key, (candidate, decision, waiting)
    client.close()
    service.stop()


def elsewhere(site, postgres, s3, folder):
    """Fresh storage of the other kind."""
    return (
        embedded(folder / "new")
        if site[0].name == "scaled"
        else scaled(folder / "new", postgres, s3)
    )


@pytest.mark.parametrize("site", ["scaled"], indirect=True)
def test_a_backup_made_while_it_runs_is_restored_on_the_other_kind_of_storage_and_goes_on(
    site, postgres, s3, tmp_path
):
    storage, service, _, key, (_, decision, waiting) = site
    backup = tmp_path / "backup"
    assert "sha256:" in run(storage, "backup", backup).stdout
    with closing(storage.build()) as parts:
        blobs = {backup / "blobs" / "sha256" / digest for digest in parts.blobs.all()}
    written = {p: p.stat().st_ino for p in blobs}
    assert sum(p.stat().st_size for p in blobs) > 10_000
    # a second one into the same folder copies no recording and no model again
    assert "sha256:" in run(storage, "backup", backup).stdout
    assert {p: p.stat().st_ino for p in blobs} == written
    assert verified(backup, key) == (0, "holds\n")
    fresh = elsewhere(site, postgres, s3, tmp_path)
    signing = (
        storage.environment.get("TRUEUP_SIGNING_KEY")
        or (site[2] / "data" / "signing.key").read_text().strip()
    )
    fresh.environment["TRUEUP_SIGNING_KEY"] = signing
    assert "1 jobs go on" in run(fresh, "restore", backup, "--key", key).stdout
    assert "whole" in run(fresh, "fsck").stdout
    assert run(fresh, "restore", backup, check=False).returncode == 1  # not over what is there
    with (
        Service(fresh).running() as restored,
        closing(Client(restored.url)) as client,
        closing(Client(service.url)) as before,
    ):
        assert client.serving("p") == before.serving("p")
        assert client.wait(waiting)["state"] == "succeeded"
        assert command(restored, "replay", decision).returncode == 0
        assert command(restored, "audit", "verify").returncode == 0
        assert client.audit_key() == key


@pytest.mark.parametrize("site", ["embedded"], indirect=True)
def test_a_plant_goes_to_another_site_with_its_whole_history(site, postgres, s3, tmp_path):
    storage, service, _, key, (_, decision, _) = site
    archive = tmp_path / "p.tar"
    run(storage, "export", "p", archive)
    assert verified(archive, key) == (0, "holds\n")
    assert "secret" not in archive.read_bytes().decode("latin-1")
    with tarfile.open(archive) as opened:
        told = next(
            m
            for m in opened.getmembers()
            if m.size and b'"sequence"' in opened.extractfile(m).read()
        )
        assert b'"plant":"other"' not in opened.extractfile(told).read()
    there = elsewhere(site, postgres, s3, tmp_path)
    run(there, "import", archive, "--key", key)
    again = run(there, "import", archive, "--key", key, check=False)
    assert (again.returncode, "conflict" in again.stderr) == (1, True), again.stderr
    assert "whole" in run(there, "fsck").stdout
    with (
        Service(there).running() as other,
        closing(Client(other.url)) as client,
        closing(Client(service.url)) as before,
    ):
        assert client.serving("p") == before.serving("p")
        assert list(client.history("p")) == list(before.history("p"))
        assert list(client.labels("p")) == list(before.labels("p")) != []
        assert [e["kind"] for e in client.audit("p")] == ["plant:imported"]
        assert [p["name"] for p in client.plants()] == ["p"]
        assert command(other, "replay", decision).returncode == 0
        assert command(other, "audit", "verify").returncode == 0
        back = client.roll_back("p", client.serving("p").generation)
        assert back.version == 1
    again = tmp_path / "again.tar"
    run(there, "export", "p", again)
    assert verified(again)[0] == 0


@pytest.mark.parametrize("site", ["embedded"], indirect=True)
def test_a_plant_whose_job_has_the_name_of_another_ones_is_refused_whole(site, tmp_path):
    storage, service, _, key, _ = site
    run(storage, "export", "p", tmp_path / "p.tar")
    with closing(Client(service.url)) as client:
        job = next(job["id"] for job in client.jobs("p") if job["state"] == "succeeded")
    there = embedded(tmp_path / "there")
    parts = there.build()
    with writing(parts.database) as tx:
        register_plant(tx, plant_document("other"), CONTEXT)
        tx.jobs.add(
            JobRecord(
                job,
                "other",
                "watch",
                {},
                JobState.QUEUED,
                0.0,
                "queued",
                None,
                CONTEXT.now,
                "tester",
                CONTEXT.now,
            )
        )
    parts.close()
    refused = run(there, "import", tmp_path / "p.tar", "--key", key, check=False)
    assert (
        refused.returncode,
        "conflict" in refused.stderr,
        "Nothing was taken in" in refused.stderr,
    ) == (1, True, True)
    with closing(there.build()) as parts, reading(parts.database) as tx:
        assert tx.plants.get("p") is None
        assert tx.jobs.get(job).plant == "other"


@pytest.mark.parametrize("site", ["embedded"], indirect=True)
def test_an_archive_that_was_changed_anywhere_is_refused_by_both(site, tmp_path):
    storage, _, _, key, _ = site
    run(storage, "export", "p", tmp_path / "good")
    fresh = embedded(tmp_path / "fresh")
    parts = sorted((tmp_path / "good" / "blobs" / "sha256").iterdir())
    changed = 0

    def whole_again():
        shutil.rmtree(tmp_path / "bad", ignore_errors=True)
        shutil.copytree(tmp_path / "good", tmp_path / "bad")

    for part in parts:
        whole_again()
        victim, data = (
            tmp_path / "bad" / "blobs" / "sha256" / part.name,
            bytearray(part.read_bytes()),
        )
        if not data:
            continue
        data[len(data) // 2] ^= 1
        victim.write_bytes(data)
        assert verified_here(tmp_path / "bad", key) == 4
        changed += 1
        if changed == 5:  # the other verifier, a process each
            assert run(fresh, "import", tmp_path / "bad", "--any-key", check=False).returncode == 1
    assert changed > 10
    kept = (
        storage.environment.get("TRUEUP_SIGNING_KEY")
        or (site[2] / "data" / "signing.key").read_text()
    )
    whole_again()  # whichever part the last one was
    # by somebody who knows the form, and has no key
    rewrite(tmp_path / "bad", "log/entries.jsonl", lambda data: data, None)
    assert "not signed" in verified(tmp_path / "bad", key)[1]
    assert run(fresh, "import", tmp_path / "bad", "--key", key, check=False).returncode == 4
    for name, (title, change) in EDITS.items():  # and by somebody who has it
        whole_again()
        rewrite(tmp_path / "bad", title, change, Signer.from_text(kept))
        code, said = verified(tmp_path / "bad", key)
        assert (code, "cannot be read" in said) == (4, False), name
        refused = run(fresh, "import", tmp_path / "bad", "--any-key", check=False)
        assert (refused.returncode, "archive-not-whole" in refused.stderr) == (1, True), name
    other = json.loads((ROOT / "tests" / "golden" / "tlog" / "vectors.json").read_text())[
        "verifier"
    ]
    assert verified(tmp_path / "good", other)[0] == 4
    assert run(fresh, "import", tmp_path / "good", "--key", other, check=False).returncode == 4
    assert run(fresh, "import", tmp_path / "nothing", check=False).returncode == 1


def rewrite(folder, title, change, signer):
    """Change a layer and name everything anew; signed again where there is a key."""

    def put(data):
        digest = hashlib.sha256(data).hexdigest()
        (folder / "blobs" / "sha256" / digest).write_bytes(data)
        return f"sha256:{digest}"

    def get(digest):
        return (folder / "blobs" / "sha256" / digest.partition(":")[2]).read_bytes()

    index = json.loads((folder / "index.json").read_text())
    manifest = json.loads(get(index["manifests"][0]["digest"]))
    layer = next(
        x for x in manifest["layers"] if x["annotations"]["org.opencontainers.image.title"] == title
    )
    layer["digest"] = put(change(get(layer["digest"])))
    described = index["manifests"][0]
    described["digest"] = put(json.dumps(manifest).encode())
    described["size"] = len(json.dumps(manifest).encode())
    if signer is not None:
        described["annotations"] = {SIGNATURE: signer.note(statement_of(described["digest"]))}
    (folder / "index.json").write_text(json.dumps(index))


def swapped_proofs(data):
    told = [json.loads(line) for line in data.splitlines()]
    told[0]["proof"], told[1]["proof"] = told[1]["proof"], told[0]["proof"]
    return b"".join(json.dumps(line).encode() + b"\n" for line in told)


def without_the_last(data):
    return b"".join(data.splitlines(keepends=True)[:-1])


EDITS = {
    "a row is gone": ("rows/gates.jsonl", without_the_last),
    "a proof is of another": ("log/entries.jsonl", swapped_proofs),
    "entries in another order": (
        "log/entries.jsonl",
        lambda data: b"".join(data.splitlines(keepends=True)[::-1]),
    ),
    "a row of another plant": (
        "rows/episodes.jsonl",
        lambda data: data.replace(b'"plant":"p"', b'"plant":"q"'),
    ),
}


# -- what is left over


def test_gc_removes_what_nothing_names_and_nothing_else(site, tmp_path):
    storage, service, _, _, _ = site
    parts = storage.build()
    before = set(parts.blobs.all())
    with closing(Client(service.url)) as client:
        arrays = b"nobody will name this" + os.urandom(8)
        digest = hashlib.sha256(arrays).hexdigest()
        client._connection.whole(
            "PUT",
            f"/v1/blobs/{digest}",
            lambda: arrays,
            {"Content-Type": "application/octet-stream"},
        )
        assert set(parts.blobs.all()) == before | {digest}
        assert "0 blobs" in run(storage, "gc").stdout  # it is young
        assert "1 blobs" in run(storage, "gc", "--older-than-h", "0", "--dry-run").stdout
        assert set(parts.blobs.all()) == before | {digest}
        assert "1 blobs" in run(storage, "gc", "--older-than-h", "0").stdout
        assert set(parts.blobs.all()) == before
        assert "whole" in run(storage, "fsck").stdout
    parts.close()


def test_what_is_put_while_it_is_being_removed_stays(tmp_path):
    from trueup_service.registry.folder_blobs import FolderBlobs

    blobs, data = FolderBlobs(tmp_path / "blobs"), b"left over"
    source = save(tmp_path, "source", data)
    digest = hashlib.sha256(data).hexdigest()
    blobs.put(digest, source)
    assert blobs.remove(digest, 3600, dry_run=False) is None
    assert blobs.remove(digest, 0, dry_run=False) == len(data)
    assert not blobs.holds(digest)
    assert list(blobs.removed()) == [digest]
    blobs.put(digest, source)  # while its bytes are set aside
    blobs.restore(digest)  # which had to be: somebody names them meanwhile
    assert (blobs.get(digest), list(blobs.removed())) == (data, [])
    assert blobs.remove(digest, 0, dry_run=False) == len(data)
    blobs.put(digest, source)
    blobs.forget(digest)  # nobody named what was there before
    assert (blobs.get(digest), list(blobs.removed())) == (data, [])
    old = blobs._path(digest)
    os.utime(old, (0, 0))
    blobs.put(digest, source)  # an upload finds its bytes there, and makes them young again
    assert blobs.remove(digest, 3600, dry_run=False) is None
    assert blobs.get(digest) == data


# -- uploads in parts


def test_an_upload_goes_on_where_it_broke_off(service, tmp_path, monkeypatch):

    plant, data = f"p{uuid.uuid4().hex[:8]}", episode_bytes(3, 4000, role=Role.VALIDATION)
    digest, path = hashlib.sha256(data).hexdigest(), save(tmp_path, "long.mcap", data)
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document(plant))
        at = f"/v1/plants/{plant}/uploads/{digest}"
        assert client._get(at)["offset_bytes"] == 0
        half = {"Upload-Offset": "0", "Content-Type": "application/octet-stream"}
        client._connection.once("PATCH", at, data[: len(data) // 2], half)
        assert client._get(at)["offset_bytes"] == len(data) // 2
        with pytest.raises(Problem) as refused:
            client._connection.once("PATCH", at, data, half)
        assert (refused.value.code, refused.value.facts["offset_bytes"]) == (
            "upload-offset",
            len(data) // 2,
        )
        monkeypatch.setattr(plants, "RESUMABLE_FROM_BYTES", 1000)
        shares = []
        assert client.upload_episode(plant, path, shares.append)["digest"] == digest
        assert shares[-1] == 1.0
        assert next(client.episodes(plant))["digest"] == digest
        assert client._get(at)["offset_bytes"] == 0
        # its answer may have been lost
        assert client._post(f"{at}/finish", None)["digest"] == digest
        wrong = f"/v1/plants/{plant}/uploads/{'0' * 64}"
        client._connection.once("PATCH", wrong, b"something else", half)
        with pytest.raises(Problem) as refused:
            client._post(f"{wrong}/finish", None)
        assert refused.value.code == "digest-mismatch"
        assert client._get(wrong)["offset_bytes"] == 0
        with pytest.raises(Problem) as refused:
            client._post(f"{wrong}/finish", None)
        assert refused.value.code == "not-found"


def test_parts_survive_the_death_of_the_server(tmp_path):

    service = Service(embedded(tmp_path / "data"))
    child, data = service.start_server(), episode_bytes(3, 4000)
    digest = hashlib.sha256(data).hexdigest()
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document("p"))
        line = socket.create_connection(("127.0.0.1", service.port))
        head = (
            f"PATCH /v1/plants/p/uploads/{digest} HTTP/1.1\r\nHost: "
            f"127.0.0.1\r\nAuthorization: Bearer {os.environ['TRUEUP_TOKEN']}\r\n"
        )
        line.sendall(
            f"{head}Upload-Offset: 0\r\nContent-Length: {len(data)}\r\n\r\n".encode()
            + data[:10_000]
        )
        until(lambda: client._get(f"/v1/plants/p/uploads/{digest}")["offset_bytes"] == 10_000)
        line.close()
        kill(child)
        service.start_server()
        assert client._get(f"/v1/plants/p/uploads/{digest}")["offset_bytes"] == 10_000
        client._upload_in_parts(
            f"/v1/plants/p/uploads/{digest}", save(tmp_path, "e.mcap", data), lambda _: None
        )
        assert next(client.episodes("p"))["digest"] == digest
    service.stop()
