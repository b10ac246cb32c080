"""Archives that somebody made to do harm: what a few bytes unfold to, what is nested without end,
and keys that nobody vouches for."""

import base64
import hashlib
import io
import json
import os
import resource
import subprocess
import sys
import tarfile

import pytest

from tests.flow.test_archives import VERIFIER, run
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import ROOT, Service
from tests.support.storage import embedded
from trueup.episode.role import Role
from trueup.ledger.archive import dangling_rows
from trueup.ledger.archive_layout import (
    ARTIFACT,
    ENDORSEMENTS,
    ENTRIES,
    MANIFEST,
    SIGNATURE,
    statement_of,
)
from trueup.ledger.archive_writer import ArchiveWriter
from trueup.ledger.signed_note import Signer
from trueup_client import Client

LIMIT_BYTES = 2 << 30  # of address space, for a program that holds an archive of a few kilobytes
UNFOLDED = 7 << 30
ROOT_OF_NONE = base64.b64encode(bytes(32)).decode()
FORGER = Signer("forger", b"1" * 32)


def limited(command, **environment):
    """A program that may take so much memory and no more."""
    return subprocess.run(
        command,
        env={
            **os.environ,
            **environment,
            "NO_COLOR": "1",
            "COLUMNS": "200",
            "OPENBLAS_NUM_THREADS": "1",
        },
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES,) * 2),
    )


def imported(archive, storage, *more):
    return limited(
        [sys.executable, "-m", "trueup_cli.main", "import", str(archive), *more],
        **storage.environment,
    )


def index_of(digest, size, notes=()):
    described = {
        "mediaType": MANIFEST,
        "artifactType": ARTIFACT,
        "digest": f"sha256:{digest}",
        "size": size,
    }
    described["annotations"] = {SIGNATURE: FORGER.note(statement_of(f"sha256:{digest}"))}
    if notes:
        described["annotations"][ENDORSEMENTS] = json.dumps(notes)
    return json.dumps({"schemaVersion": 2, "manifests": [described]}).encode()


def sparse(name, size):
    """A member of a tar file that unfolds to so many bytes of nothing: a header of GNU tar that
    says there is no data."""
    head = bytearray(512)
    head[0 : len(name)] = name.encode()
    head[100:108], head[108:116], head[116:124] = b"0000644\0", b"0000000\0", b"0000000\0"
    head[124:136] = b"00000000000\0"
    head[136:148], head[156:157] = b"00000000000\0", b"S"
    head[257:265] = b"ustar  \0"
    head[386:398], head[398:410] = b"%011o\0" % (size % 8**11), b"00000000000\0"
    head[483:495] = bytes([0x80, *size.to_bytes(11, "big")])
    head[148:156] = b" " * 8
    head[148:156] = b"%06o\0 " % sum(head)
    return bytes(head)


def tarred(path, files, *raw):
    """A tar file of files, and of headers as they are."""
    plain = io.BytesIO()
    with tarfile.open(fileobj=plain, mode="w") as archive:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
        end = archive.offset
    path.write_bytes(plain.getvalue()[:end] + b"".join(raw) + bytes(1024))


def bomb(path):
    digest = "0" * 64
    tarred(
        path, {"index.json": index_of(digest, UNFOLDED)}, sparse(f"blobs/sha256/{digest}", UNFOLDED)
    )


def nested(path):
    data = b"[" * 500_000
    digest = hashlib.sha256(data).hexdigest()
    tarred(path, {"index.json": index_of(digest, len(data)), f"blobs/sha256/{digest}": data})


def nested_index(path):
    tarred(path, {"index.json": b'{"manifests":' * 70_000})


def negative(path):
    data = b"{}"
    digest = hashlib.sha256(data).hexdigest()
    tarred(path, {"index.json": index_of(digest, -1), f"blobs/sha256/{digest}": data})


def cut_short(path):
    data = b"x" * 5000
    digest = hashlib.sha256(data).hexdigest()
    tarred(path, {"index.json": index_of(digest, len(data)), f"blobs/sha256/{digest}": data})
    path.write_bytes(path.read_bytes()[:4000])


def extended(path, kind, size):
    """A header that only says something of the next one, or of all others, in so many bytes."""
    info = tarfile.TarInfo("././@PaxHeader")
    info.size, info.type = size, kind
    path.write_bytes(info.tobuf(tarfile.USTAR_FORMAT) + bytes(2048))


def long_extension(path):
    extended(path, tarfile.XHDTYPE, 3 << 30)


def long_name(path):
    extended(path, tarfile.GNUTYPE_LONGNAME, 3 << 30)


def extension_of_all(path):
    extended(path, tarfile.XGLTYPE, 512)


def endless_keys(path):
    """A manifest signature whose key was handed over so often that checking takes hours."""
    data = b"{}"
    digest = hashlib.sha256(data).hexdigest()
    index = index_of(digest, len(data), [FORGER.note("a\n")] * 3000)
    tarred(path, {"index.json": index, f"blobs/sha256/{digest}": data})


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_what_is_no_regular_file_in_a_folder_is_not_read(kind, tmp_path):
    (tmp_path / "archive" / "blobs" / "sha256").mkdir(parents=True)
    index = tmp_path / "archive" / "index.json"
    os.mkfifo(index) if kind == "pipe" else index.symlink_to("/dev/zero")
    done = imported(tmp_path / "archive", embedded(tmp_path / "data"), "--any-key")
    assert (done.returncode, "bad-archive" in done.stderr) == (1, True), done.stderr[-2000:]
    done = limited([sys.executable, "-I", str(VERIFIER), str(tmp_path / "archive")])
    assert (done.returncode, "no regular file" in done.stdout) == (4, True), (
        done.stdout + done.stderr[-2000:]
    )


@pytest.mark.parametrize("size", [3 * 10**9, 10**30])
def test_a_log_that_says_it_is_longer_than_memory_is_refused(size, tmp_path):
    config = {
        "plant": None,
        "key": FORGER.verifier,
        "endorsements": [],
        "checkpoint": FORGER.note(f"forger\n{size}\n{ROOT_OF_NONE}\n"),
    }
    with ArchiveWriter(tmp_path / "long.tar") as archive:
        archive.add("log/entries.jsonl", ENTRIES, b"")
        archive.close(config, FORGER.note)
    done = limited([sys.executable, "-I", str(VERIFIER), str(tmp_path / "long.tar")])
    assert (done.returncode, f"signed for {size}" in done.stdout) == (4, True), (
        done.stdout + done.stderr[-2000:]
    )
    data = embedded(tmp_path / "data")
    restored = limited(
        [
            sys.executable,
            "-m",
            "trueup_cli.main",
            "restore",
            str(tmp_path / "long.tar"),
            "--any-key",
        ],
        **data.environment,
    )
    assert (restored.returncode, "not-whole" in restored.stderr) == (1, True), restored.stderr[
        -2000:
    ]


@pytest.mark.parametrize(
    "spoilt", [{}, {"sequence": "1"}, {"rows": []}, {"facts": [1]}, {"at": None}]
)
def test_an_entry_of_another_form_is_refused(spoilt, tmp_path):
    entry = {
        "sequence": 1,
        "at": "",
        "kind": "a:b",
        "actor": "",
        "plant": None,
        "subject": "",
        "facts": {},
        "rows": {},
    } | spoilt
    config = {
        "plant": None,
        "key": FORGER.verifier,
        "endorsements": [],
        "checkpoint": FORGER.note(f"forger\n1\n{ROOT_OF_NONE}\n"),
    }
    with ArchiveWriter(tmp_path / "odd.tar") as archive:
        archive.add(
            "log/entries.jsonl", ENTRIES, json.dumps({"entry": entry, "proof": []}).encode()
        )
        archive.close(config, FORGER.note)
    done = run(
        embedded(tmp_path / "data"), "restore", tmp_path / "odd.tar", "--any-key", check=False
    )
    assert done.returncode in (1, 4)
    # one that is as it should be is refused because the signed root is of no such log
    assert ("another form" in done.stderr) == bool(spoilt)
    assert "Traceback" not in done.stderr
    assert limited([sys.executable, "-I", str(VERIFIER), str(tmp_path / "odd.tar")]).returncode == 4


class Rows:
    """An archive of rows alone."""

    def __init__(self, **rows):
        self._rows = rows

    def rows(self, table):
        return self._rows.get(table, [])


def test_a_row_that_hangs_on_another_plants_job_is_found():
    output = {"plant": "q", "job": "of p", "name": "report"}
    assert dangling_rows(Rows(outputs=[output])) == ["outputs/of p/report"]
    assert dangling_rows(Rows(outputs=[output], jobs=[{"id": "of p"}])) == []
    move = {"plant": "q", "generation": 2, "decision": "e"}
    assert dangling_rows(Rows(decisions=[{"digest": "d", "job": None}], moves=[move])) == [
        "moves/q/2"
    ]


ODD = {  # what the command says of each, and what the verifier, where it reads so far
    bomb: ("no plain file that lies in the tar file whole", "no plain file"),
    nested: ("nested beyond reason", "RecursionError"),
    nested_index: ("nested beyond reason", "RecursionError"),
    negative: ("says that it has -1 bytes", "KeyError"),
    cut_short: ("a header of the tar file says 5000 bytes", "5000 bytes"),
    long_extension: ("a header of the tar file says 3221225472 bytes", "3221225472 bytes"),
    long_name: ("a header of the tar file says 3221225472 bytes", "3221225472 bytes"),
    extension_of_all: ("or speaks for all others", "or speaks for all others"),
    endless_keys: ("handed over 3000 times", "KeyError"),
}


@pytest.mark.parametrize("made", ODD)
def test_what_unfolds_or_is_nested_is_refused_within_little_memory(made, tmp_path):
    made(tmp_path / "archive.tar")
    here, there = ODD[made]
    for key in (["--any-key"], ["--key", FORGER.verifier]):
        done = imported(tmp_path / "archive.tar", embedded(tmp_path / "data"), *key)
        assert done.returncode == 1, done.stderr[-2000:]
        assert "bad-archive" in done.stderr
        assert here in done.stderr
    done = limited([sys.executable, "-I", str(VERIFIER), str(tmp_path / "archive.tar")])
    assert done.returncode == 4, done.stdout + done.stderr[-2000:]
    assert "cannot be read" in done.stdout
    assert there in done.stdout


def test_a_large_manifest_in_a_folder_with_holes_is_not_read_before_its_signature_is_known(
    tmp_path,
):
    digest = "0" * 64
    (tmp_path / "archive" / "blobs" / "sha256").mkdir(parents=True)
    (tmp_path / "archive" / "index.json").write_bytes(index_of(digest, 3 << 30))
    with (tmp_path / "archive" / "blobs" / "sha256" / digest).open("wb") as file:
        file.truncate(3 << 30)
    for key in (["--any-key"], ["--key", Signer("honest", b"2" * 32).verifier]):
        done = imported(tmp_path / "archive", embedded(tmp_path / "data"), *key)
        assert (done.returncode, "nothing shows who signed it" in done.stderr) == (1, True), (
            done.stderr[-2000:]
        )


# -- keys


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A plant's archive, and the key of its log."""
    folder = tmp_path_factory.mktemp("exported")
    storage = embedded(folder / "data")
    with Service(storage).running(worker=False) as service:
        client = Client(service.url)
        client.register_plant(plant_document("p"))
        client.upload_episode("p", save(folder, "0.mcap", episode_bytes(0, role=Role.ADAPTATION)))
        key = client.audit_key()
        client.close()
    run(storage, "export", "p", folder / "p.tar")
    return storage, folder / "p.tar", key


def test_an_archive_that_nobody_vouches_for_is_not_taken_without_a_word(exported, tmp_path):
    _, archive, key = exported
    fresh = embedded(tmp_path / "fresh")
    refused = run(fresh, "import", archive, check=False)
    assert (refused.returncode, key in refused.stderr, "key-not-given" in refused.stderr) == (
        1,
        True,
        True,
    )
    assert not (tmp_path / "fresh" / "trueup.sqlite").exists()  # nothing was begun
    taken = run(fresh, "import", archive, "--any-key")
    assert "is not verified" in taken.stderr
    assert key in taken.stderr


def test_the_key_that_is_given_is_the_one_that_counts(exported, tmp_path):
    _, archive, key = exported
    fresh = embedded(tmp_path / "fresh")
    assert run(fresh, "import", archive, "--key", FORGER.verifier, check=False).returncode == 4
    assert "is not verified" not in run(fresh, "import", archive, "--key", key).stderr


def test_an_installation_believes_its_own_key(exported, tmp_path):
    storage, _, _ = exported
    run(storage, "backup", tmp_path / "backup")
    fresh = embedded(tmp_path / "fresh")
    (tmp_path / "fresh").mkdir()
    (tmp_path / "fresh" / "signing.key").write_text(
        (storage.settings().data_dir / "signing.key").read_text()
    )
    done = run(fresh, "restore", tmp_path / "backup")
    assert "restored" in done.stdout
    assert "is not verified" not in done.stderr
