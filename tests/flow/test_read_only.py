"""A data folder that cannot be written, such as a snapshot that somebody mounts to look at it: it
is checked, and nothing in it moves."""

import os
import shutil
import subprocess
import sys
from contextlib import closing

import pytest

from tests.support.service import ROOT, Service, command, kill
from tests.support.storage import embedded
from tests.support.tampering import promoted
from trueup.ledger.signed_note import Signer
from trueup.ledger.verification import verify
from trueup_client import Client
from trueup_service import wiring
from trueup_service.installation import Installation, lost_jobs, published

NAMESPACES = (["unshare", "--mount"], ["unshare", "--user", "--map-root-user", "--mount"])


def fingerprint(folder):
    """Every file with its size and its times, but for what SQLite shares among those who have a
    database open."""
    files = (p for p in sorted(folder.rglob("*")) if not p.name.endswith(("-shm", "-wal")))
    return {str(p): (p.stat().st_size, p.stat().st_mtime_ns, p.stat().st_mode) for p in files}


@pytest.fixture(scope="module", params=["stopped", "killed"])
def site(request, tmp_path_factory):
    """What a service leaves behind when it ends, or when it is killed, with entries that are in the
    write-ahead log alone."""
    folder = tmp_path_factory.mktemp("read-only")
    storage = embedded(folder / "data")
    service = Service(storage)
    server, worker = service.start_server(), service.start_worker()
    with closing(Client(service.url)) as client:
        promoted(client, folder)
    if request.param == "killed":
        kill(server)
        kill(worker)
        assert (folder / "data" / "trueup.sqlite-wal").stat().st_size > 0
    service.stop()
    return storage, folder / "data"


@pytest.mark.parametrize(
    "shared", [True, False], ids=["as it was left", "without what SQLite shares"]
)
def test_it_is_read_from_a_copy_and_nothing_is_written(site, shared, monkeypatch, tmp_path):
    _, data = site
    copy = tmp_path / "data"
    shutil.copytree(data, copy)
    if not shared:
        (copy / "trueup.sqlite-shm").unlink(missing_ok=True)
    monkeypatch.setattr(wiring.os, "access", lambda path, mode: False)
    before = fingerprint(copy)
    with wiring.build_to_read(embedded(copy).settings()) as parts:
        found = verify(Installation(parts.database, parts.blobs))
        assert (found.findings, published(parts), lost_jobs(parts)) == ([], [], [])
        assert found.size > 5
    assert fingerprint(copy) == before


@pytest.fixture(scope="module")
def namespace():
    """How a mount of one's own is made here."""
    for words in NAMESPACES:
        if subprocess.run([*words, "true"], capture_output=True, check=False).returncode == 0:
            return words
    return pytest.skip("this machine lets nobody mount anything")


def read_only(namespace, folder, *arguments, environment):
    mount = (
        f'mount --bind "{folder}" "{folder}" && mount -o remount,ro,bind "{folder}" && ! '
        f'touch "{folder}/x" 2>/dev/null'
    )
    return subprocess.run(
        [
            *namespace,
            "sh",
            "-c",
            f'{mount} && exec "$@"',
            "sh",
            sys.executable,
            "-m",
            "trueup_cli.main",
            *arguments,
        ],
        env={**os.environ, **environment, "COLUMNS": "200", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )


def test_fsck_starts_on_a_file_system_that_is_mounted_to_be_read(site, namespace):
    storage, data = site
    before = fingerprint(data)
    done = read_only(namespace, data, "fsck", environment=storage.environment)
    assert (done.returncode, done.stdout.startswith("whole")) == (0, True), done.stderr
    assert fingerprint(data) == before
    blob = next(p for p in (data / "blobs").rglob("*") if p.is_file())
    kept = blob.read_bytes()
    blob.chmod(0o600)
    blob.write_bytes(bytes([kept[0] ^ 1]) + kept[1:])
    assert read_only(namespace, data, "fsck", environment=storage.environment).returncode == 4
    blob.write_bytes(kept)


def test_verify_goes_on_where_it_cannot_keep_what_it_saw(namespace, tmp_path):
    storage = embedded(tmp_path / "data")
    (tmp_path / "state").mkdir()
    with Service(storage).running(worker=False) as service:
        with closing(Client(service.url)) as client:
            key = client.audit_key()
        environment = {
            "TRUEUP_URL": service.url,
            "XDG_STATE_HOME": str(tmp_path / "state"),
            "TRUEUP_LOG_KEY": key,
        }
        done = read_only(namespace, tmp_path / "state", "audit", "verify", environment=environment)
        assert (done.returncode, "holds" in done.stdout, "is not kept" in done.stderr) == (
            0,
            True,
            True,
        ), done.stderr
        other = {**environment, "TRUEUP_LOG_KEY": Signer("another", b"7" * 32).verifier}
        assert (
            read_only(
                namespace, tmp_path / "state", "audit", "verify", environment=other
            ).returncode
            == 4
        )
        assert command(service, "audit", "verify").returncode == 0
