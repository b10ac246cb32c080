"""Models and archives go to an OCI registry and come back byte by byte; what comes back otherwise
is refused."""

import io
import json
import tarfile

import pytest

from tests.support.made import plant_document
from tests.support.oci_registry import digest_of, oci_registry
from tests.unit.test_convert import kept
from trueup.artifact.model import load
from trueup.errors import NotExportable, OciRefused
from trueup.ledger.archive_layout import EPISODE
from trueup.ledger.archive_writer import ArchiveWriter
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal
from trueup_cli import oci

PART = bytes(range(256)) * 50


@pytest.fixture
def registry():
    with oci_registry() as running:
        yield running


@pytest.fixture
def model(tmp_path):
    kept(Nominal(Plant.from_document(plant_document())), tmp_path / "m")
    return tmp_path / "m"


def archive(path):
    """Writes an archive of a recording, signed by nobody, and returns its files by name."""
    with ArchiveWriter(path) as writer:
        digest = digest_of(PART).removeprefix("sha256:")
        writer.add("rows/plants.jsonl", "application/jsonl", b'{"a": 1}\n')
        writer.add_parts("episodes/one.mcap", EPISODE, digest, len(PART), [PART[:99], PART[99:]])
        writer.close({"plant": None}, lambda statement: f"signed: {statement}")


def test_a_model_comes_back_as_it_was(registry, model, tmp_path, capsys):
    oci.push(model, f"{registry.host}/robots/bench:v1")
    capsys.readouterr()
    oci.pull(f"{registry.host}/robots/bench:v1", tmp_path / "back", as_json_=True)
    assert load(tmp_path / "back").digest == load(model).digest
    assert {p.name for p in (tmp_path / "back").iterdir()} == {p.name for p in model.iterdir()}
    printed = json.loads(capsys.readouterr().out)
    by_digest = f"{registry.host}/robots/bench@{printed['digest']}"
    oci.pull(by_digest, tmp_path / "by digest")
    assert load(tmp_path / "by digest").digest == load(model).digest


def test_what_is_there_already_is_not_sent_again(registry, model):
    oci.push(model, f"{registry.host}/robots/bench:v1")
    before = len([a for a in registry.asked if a[0] == "POST"])
    oci.push(model, f"{registry.host}/robots/bench:v2")
    assert len([a for a in registry.asked if a[0] == "POST"]) == before > 0
    tags = [registry.manifests["robots/bench", tag] for tag in ("v1", "v2")]
    assert tags[0] == tags[1]


@pytest.mark.parametrize("name", ["archive", "archive.tar"])
def test_an_archive_comes_back_with_the_signature_in_its_index(
    registry, tmp_path, name, monkeypatch
):
    monkeypatch.setattr(oci, "AT_ONCE", 1000)  # the recording goes in chunks
    archive(tmp_path / name)
    oci.push(tmp_path / name, f"{registry.host}/site/bench:2026-11")
    oci.pull(f"{registry.host}/site/bench:2026-11", tmp_path / "back")
    archive(tmp_path / "as written")
    files = {
        p.relative_to(tmp_path / "as written"): p.read_bytes()
        for p in (tmp_path / "as written").rglob("*")
        if p.is_file()
    }
    assert len(files) == 6
    for path, content in files.items():
        assert (tmp_path / "back" / path).read_bytes() == content, path
    assert "signed: " in (tmp_path / "back" / "index.json").read_text()


@pytest.mark.parametrize("spoil", [lambda b: b[:-1], lambda b: b + b" ", lambda b: b"x" + b[1:]])
def test_a_registry_that_sends_other_bytes_is_caught(registry, model, tmp_path, spoil):
    oci.push(model, f"{registry.host}/robots/bench:v1")
    named = digest_of((model / "manifest.json").read_bytes())
    registry.blobs[named] = spoil(registry.blobs[named])
    with pytest.raises(OciRefused, match="other bytes than sha256:"):
        oci.pull(f"{registry.host}/robots/bench:v1", tmp_path / "back")
    assert not (tmp_path / "back" / "manifest.json").exists()
    assert list(tmp_path.glob("back*")) == []  # nothing half is left, and the next pull can begin


def test_a_manifest_that_its_digest_does_not_name_is_caught(registry, model, tmp_path, capsys):
    oci.push(model, f"{registry.host}/robots/bench:v1", as_json_=True)
    digest = json.loads(capsys.readouterr().out)["digest"]
    kind, data = registry.manifests["robots/bench", digest]
    registry.manifests["robots/bench", digest] = kind, data + b" "
    with pytest.raises(OciRefused, match="other bytes"):
        oci.pull(f"{registry.host}/robots/bench@{digest}", tmp_path / "back")


def test_what_is_no_model_or_archive_is_said(registry, tmp_path):
    document = {"schemaVersion": 2, "artifactType": "application/vnd.acme", "layers": []}
    kept_as = oci.IMAGE, json.dumps(document).encode()
    registry.manifests["robots/other", "v1"] = kept_as
    with pytest.raises(OciRefused, match=r"is a application/vnd\.acme, no model"):
        oci.pull(f"{registry.host}/robots/other:v1", tmp_path / "back")
    with pytest.raises(OciRefused, match=r"404.*MANIFEST_UNKNOWN"):
        oci.pull(f"{registry.host}/robots/none:v1", tmp_path / "back")
    with pytest.raises(NotExportable, match="no whole archive"):
        (tmp_path / "text.tar").write_text("no archive")
        oci.push(tmp_path / "text.tar", f"{registry.host}/robots/other:v1")
    with tarfile.open(tmp_path / "empty.tar", "w") as tar:
        tar.addfile(tarfile.TarInfo("readme"), io.BytesIO(b""))
    with pytest.raises(NotExportable, match="no whole archive"):
        oci.push(tmp_path / "empty.tar", f"{registry.host}/robots/other:v1")


def test_a_blob_of_another_name_than_its_digest_is_no_path(registry, tmp_path):
    layer = {"mediaType": "x", "digest": "sha256:../../up", "size": 1}
    manifest = json.dumps({"config": layer, "layers": []}).encode()
    registry.manifests["site/bench", digest_of(manifest)] = oci.IMAGE, manifest
    index = {"manifests": [{"digest": digest_of(manifest)}]}
    registry.manifests["site/bench", "v1"] = oci.INDEX, json.dumps(index).encode()
    with pytest.raises(OciRefused, match="no SHA-256"):
        oci.pull(f"{registry.host}/site/bench:v1", tmp_path / "back")


@pytest.mark.parametrize(
    "document",
    [b"[]", b"{}", b"not json", b'{"artifactType": "application/vnd.trueup.model.v1"}',
     b'{"artifactType": "application/vnd.trueup.model.v1", "layers": [{"annotations": 1}]}'],
)  # fmt: skip
@pytest.mark.parametrize("kind", [oci.IMAGE, oci.INDEX])
def test_a_manifest_that_makes_no_sense_is_refused(registry, tmp_path, kind, document):
    registry.manifests["robots/bench", "v1"] = kind, document
    with pytest.raises(OciRefused):
        oci.pull(f"{registry.host}/robots/bench:v1", tmp_path / "back")
    assert not (tmp_path / "back").exists()


def test_a_registry_that_says_no_is_quoted(registry, model, tmp_path):
    registry.refuses = 403, b'{"errors": [{"code": "DENIED"}]}'
    with pytest.raises(OciRefused) as refused:
        oci.push(model, f"{registry.host}/robots/bench:v1")
    assert registry.host in str(refused.value)
    registry.refuses = 500, b"out of order"
    with pytest.raises(OciRefused, match="500 out of order"):
        oci.pull(f"{registry.host}/robots/bench:v1", tmp_path / "back")
    with pytest.raises(OciRefused, match="names no registry"):
        oci.pull("bench:v1", tmp_path / "back")
    host = registry.host
    registry.shutdown()
    registry.server_close()
    with pytest.raises(OciRefused, match=host):
        oci.pull(f"{host}/robots/bench:v1", tmp_path / "back")


def test_a_folder_that_holds_something_is_not_written_over(model):
    with pytest.raises(NotExportable, match="is there already"):
        oci.pull("127.0.0.1:1/robots/bench:v1", model)
