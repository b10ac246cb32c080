"""Every earlier schema, with data in it that the code of its time wrote, comes to the present one
on both storages: the log holds, decisions are recomputed, and the registry goes on."""

import os
import shutil
import subprocess
import sys
import tarfile
from contextlib import closing

import pytest
from sqlalchemy import MetaData, create_engine, text

from tests.support.forks import run
from tests.support.made import episode_bytes, save
from tests.support.service import ROOT, Service, command
from tests.support.storage import embedded, scaled
from trueup.canonical import digest_of_bytes
from trueup.episode.role import Role
from trueup.ledger.verification import verify
from trueup_client import Client
from trueup_migrations import HEAD, upgrade
from trueup_service.installation import Installation, lost_jobs, published, signing
from trueup_service.registry.database import Database
from trueup_service.registry.schema import altered, current
from trueup_service.registry.transaction import reading

GOLDEN = sorted((ROOT / "tests" / "golden" / "registries").glob("*.tar.gz"))
REVISIONS = [path.name.partition(".")[0] for path in GOLDEN]
# of SQLite, and of the job engine, which has migrations of its own
NOT_OURS = {"sqlite_sequence", "alembic_version"}


ARCHIVES = sorted((ROOT / "tests" / "golden" / "registries").glob("*.archive.tar"))


def test_there_is_a_registry_of_every_schema():
    versions = (ROOT / "migrations" / "trueup_migrations" / "versions").glob("0*.py")
    assert sorted(path.name[:4] for path in versions) == REVISIONS
    assert REVISIONS[-1] == HEAD, "run tools/golden_registry.py"


def unpacked(revision, folder):
    with tarfile.open(GOLDEN[REVISIONS.index(revision)]) as tar:
        tar.extractall(folder, filter="data")
    return folder


@pytest.fixture(params=REVISIONS)
def revision(request):
    return request.param


@pytest.fixture(params=["embedded", "scaled"])
def old(request, revision, tmp_path):
    """A storage that holds the golden registry of a schema."""
    folder = unpacked(revision, tmp_path / "data")
    if request.param == "embedded":
        return embedded(folder)
    fixture = request.getfixturevalue
    storage = scaled(tmp_path / "elsewhere", fixture("postgres"), fixture("s3"))
    key = folder / "signing.key"
    if key.exists():
        storage.environment["TRUEUP_SIGNING_KEY"] = key.read_text().strip()
    copied(folder / "trueup.sqlite", storage, revision)
    parts = empty_blobs(storage)
    for path in (folder / "blobs").glob("??/*"):
        spooled = tmp_path / path.name
        shutil.copyfile(path, spooled)
        parts.put(digest_of_bytes(path.read_bytes()), spooled)
    return storage


def empty_blobs(storage):
    """The blobs of a storage whose database is not to be touched."""
    from trueup_service.wiring import _blobs

    return _blobs(storage.settings())


def copied(file, storage, revision):
    """Copies every row of ours from SQLite into a database of PostgreSQL of the same schema."""
    settings = storage.settings()
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    target = Database(settings.sqlalchemy_url, 2)
    with target.write() as connection:
        upgrade(connection, revision)
        tables = MetaData()
        tables.reflect(connection)
        for table in tables.sorted_tables:
            if table.name not in NOT_OURS:
                connection.execute(table.delete())
        source = create_engine(f"sqlite:///{file}")
        with source.connect() as read:
            for table in tables.sorted_tables:
                if table.name in NOT_OURS:
                    continue
                rows = read.execute(text(f'SELECT * FROM "{table.name}"')).mappings().all()
                if rows:
                    connection.execute(table.insert(), [_typed(table, row) for row in rows])
        source.dispose()
    target.close()


def _typed(table, row):
    return {
        column.name: bool(row[column.name])
        if column.type.python_type is bool and row[column.name] is not None
        else row[column.name]
        for column in table.columns
    }


def test_it_comes_to_the_present_schema_whole(old, revision):
    with closing(old.build()) as parts:
        assert current(parts.database) == HEAD
        verified = verify(Installation(parts.database, parts.blobs, signing(parts)))
        findings = [
            *verified.findings,
            *published(parts),
            *lost_jobs(parts),
            *altered(parts.database),
        ]
        assert findings == []
        with reading(parts.database) as tx:
            serving = tx.serving.now("p")
            assert (serving.version, serving.generation, serving.kind) == (1, 3, "rolled_back")
            assert len(tx.episodes.page("p", "adaptation", "", 10)) == 1
            assert len(tx.decisions.page("p", "9", 10)) == 2
            kinds = {e.kind for e in tx.log.entries(0, 1000)}
        assert ("log:migrated" in kinds) == (revision < "0003")


@pytest.mark.parametrize("old", ["embedded"], indirect=True)
def test_its_decisions_are_recomputed_and_it_goes_on(old, tmp_path):
    service = Service(old)
    with service.running(), Client(service.url) as client:
        decisions = list(client.decisions("p"))
        for decision in decisions:
            assert "agrees" in command(service, "replay", decision["digest"]).stdout
        for seed, role in ((5, Role.ADAPTATION), (6, Role.VALIDATION)):
            data = episode_bytes(seed, samples=120, role=role)
            client.upload_episode("p", save(tmp_path, f"{seed}.mcap", data))
        fit = client.wait(client.submit("p", {"kind": "fit", "method": "identify"})["id"])
        gate = client.declare_gate(
            "p", {**client.gate_in_force("p")["document"], **_following(client)}
        )
        trial = {"kind": "gate", "candidate": fit["result"]["artifact"], "gate": gate["digest"]}
        judged = client.wait(client.submit("p", trial)["id"])["result"]
        assert judged["accepted"]
        client.promote("p", judged["decision"], 3)
        assert client.serving("p").generation == 4


@pytest.mark.parametrize("archive", ARCHIVES, ids=lambda path: path.name[:4])
def test_an_archive_of_an_earlier_code_verifies_and_is_imported_and_recomputed(archive, tmp_path):
    key = archive.with_suffix(".key").read_text().strip()
    verifier = [sys.executable, "-I", str(ROOT / "tools" / "verify_archive.py")]
    subprocess.run([*verifier, str(archive), key], check=True, capture_output=True)
    storage = embedded(tmp_path / "data")
    environment = {**os.environ, **storage.environment}
    done = run("trueup_cli.main", ["import", str(archive), "--key", key], environment, ROOT)
    assert done.returncode == 0, done.stderr
    service = Service(storage)
    with service.running(worker=False), Client(service.url) as client:
        assert client.serving("p").generation == 3
        for decision in client.decisions("p"):
            assert "agrees" in command(service, "replay", decision["digest"]).stdout


def _following(client):
    return {"follows": client.gate_in_force("p")["digest"], "because": "more was recorded"}
