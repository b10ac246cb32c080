"""Commands that push models and archives to an OCI registry, and pull them from one.

A model is an OCI artifact whose layers are the files that `trueup fetch` writes, so that `oras
pull` gets them, too. An archive, which is an OCI image layout already, is pushed as it is: its
index, in which the site's signature stands, is what the tag names. Every byte that comes back is
held against the digest that names it. Source: OCI distribution and image specifications, version
1.1.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from trueup.artifact.model import ARRAYS, MANIFEST, Model, load
from trueup.canonical import Json as JsonValue
from trueup.canonical import canonical_bytes, digest_of_bytes
from trueup.errors import BadArtifact, NotExportable, NotInstalled, OciRefused
from trueup_cli.exits import VERIFIES_LOCALLY, exit_codes
from trueup_cli.options import Json
from trueup_cli.show import Bar, as_json, progress, say

app = App(
    name="oci",
    help="Push models and archives to an OCI registry, or pull them from one.",
    help_epilogue=exit_codes(VERIFIES_LOCALLY),
)
Reference = Annotated[
    str, Parameter(help="HOST/REPOSITORY:TAG, or HOST/REPOSITORY@sha256:DIGEST of what is there")
]
PlainHttp = Annotated[
    bool, Parameter(negative=(), help="Speak HTTP, not HTTPS; default for localhost")
]
IMAGE = "application/vnd.oci.image.manifest.v1+json"
INDEX = "application/vnd.oci.image.index.v1+json"
MODEL = "application/vnd.trueup.model.v1"
EMPTY = "application/vnd.oci.empty.v1+json"
FILES = {MANIFEST: f"{MODEL}.manifest+json", ARRAYS: "application/vnd.safetensors"}
TITLE = "org.opencontainers.image.title"
LAYOUT = {"imageLayoutVersion": "1.0.0"}
LOCAL = ("localhost", "127.0.0.1", "[::1]")
ANSWERS_WITHIN_S = 60.0
AT_ONCE = 32 << 20  # bytes: a larger blob is sent in chunks
LARGEST_DOCUMENT = 16 << 20  # bytes of a manifest or an index
PART = 1 << 20


@app.command
def push(
    source: Path,
    reference: Reference,
    *,
    plain_http: PlainHttp = False,
    as_json_: Json = False,
) -> None:
    """Push a model, or an archive, to an OCI registry.

    Who asks is taken from the login of docker, podman or oras. Blobs that are there already are not
    sent again.

    Parameters
    ----------
    source
        folder of a fetched model or of a diagnosis, or an archive that `trueup export` or
        `trueup backup` wrote
    """
    with _registry(reference, plain_http=plain_http) as there, progress(f"push {source}") as bar:
        digest = (
            _push_archive(there, source, bar)
            if source.is_file() or (source / "index.json").is_file()
            else _push_model(there, source)
        )
    _tell("pushed", reference, digest, as_json_=as_json_)


@app.command
def pull(
    reference: Reference,
    to: Path,
    *,
    plain_http: PlainHttp = False,
    as_json_: Json = False,
) -> None:
    """Pull a model, or an archive, from an OCI registry.

    A model is loaded once, so that its digest and its recorded predictions hold. An archive is
    verified by `trueup import` or `trueup restore`, which know the key that it must be signed with.

    Parameters
    ----------
    to
        folder to write, which is not there or empty
    """
    if to.exists() and (not to.is_dir() or any(to.iterdir())):
        raise NotExportable(f"{to} is there already", hint="Name a folder that is not there yet.")
    to.parent.mkdir(parents=True, exist_ok=True)
    with (
        _registry(reference, plain_http=plain_http) as there,
        progress(f"pull {reference}") as bar,
        tempfile.TemporaryDirectory(dir=to.parent, prefix=f"{to.name}.part") as folder,
    ):
        kind, content = there.document(there.tagged)
        whole = Path(folder) / to.name  # it is renamed when it is whole
        whole.mkdir()
        try:
            _pull(there, reference, kind, json.loads(content), whole, bar)
        except (KeyError, TypeError, AttributeError) as error:
            raise OciRefused(f"{reference} does not describe itself: {error!r}") from error
        whole.rename(to)
    _tell("pulled", reference, digest_of_bytes(content), as_json_=as_json_)


def _pull(there: _Registry, reference: str, kind: str, document: Any, to: Path, bar: Bar) -> None:
    """Writes what a manifest or an index of a media type names to a folder."""
    if kind == INDEX:
        _pull_archive(there, document, to, bar)
    elif document.get("artifactType") == MODEL:
        _pull_model(there, document, to, bar)
    else:
        raise OciRefused(
            f"{reference} is a {document.get('artifactType') or kind}, no model or archive",
            hint="Name what `trueup oci push` pushed.",
        )


def _tell(done: str, reference: str, digest: str, *, as_json_: bool) -> None:
    if as_json_:
        as_json({"reference": reference, "digest": f"sha256:{digest}"})
    else:
        say("{} {}, sha256:{}", done, reference, digest)


def _model_in(folder: Path) -> tuple[Model, Path]:
    """Returns the model of a folder, and where its files are."""
    if not folder.is_dir():
        raise NotExportable(
            f"there is no {folder}", hint="Name a model's folder, or an archive's file or folder."
        )
    inner = folder / "model"
    where = inner if (inner / MANIFEST).is_file() else folder
    return load(where), where


def _push_model(there: _Registry, source: Path) -> str:
    """Pushes a model's files, and returns the digest of their manifest."""
    model, where = _model_in(source)
    layers: list[JsonValue] = []
    for name, media_type in FILES.items():
        if (where / name).is_file():
            described = _descriptor(media_type, (where / name).read_bytes())
            there.send(described, where / name)
            layers.append(described | {"annotations": {TITLE: name}})
    empty = _descriptor(EMPTY, b"{}")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "config").write_bytes(b"{}")
        there.send(empty, Path(folder) / "config")
    manifest: dict[str, JsonValue] = {
        "schemaVersion": 2,
        "mediaType": IMAGE,
        "artifactType": MODEL,
        "config": empty,
        "layers": layers,
        "annotations": {"trueup.artifact": model.digest, "trueup.plant": model.plant.name},
    }
    return there.put(there.tagged, IMAGE, canonical_bytes(manifest))


def _push_archive(there: _Registry, source: Path, bar: Bar) -> str:
    """Pushes an archive's parts, its manifest and the index that signs it, and returns the digest
    of the index."""
    with _layout(source) as archive:
        index = archive.read("index.json")
        for described in json.loads(index)["manifests"]:
            manifest = archive.read(_blob(described["digest"]))
            document = json.loads(manifest)
            parts = [document["config"], *document["layers"]]
            for i, part in enumerate(parts):
                bar(i / len(parts), part.get("annotations", {}).get(TITLE, "configuration"))
                with archive.file(_blob(part["digest"])) as path:
                    there.send(part, path)
            there.put(described["digest"], IMAGE, manifest)
        return there.put(there.tagged, INDEX, index)


def _pull_model(there: _Registry, document: Mapping[str, Any], to: Path, bar: Bar) -> None:
    for i, layer in enumerate(document["layers"]):
        name = layer.get("annotations", {}).get(TITLE)
        if name in FILES:
            bar(i / len(document["layers"]), name)
            there.fetch(layer, to / name)
    model, named = load(to), document.get("annotations", {}).get("trueup.artifact")
    if named != model.digest:
        raise BadArtifact(f"the registry names {named}, and the files are {model.digest}")


def _pull_archive(there: _Registry, index: Mapping[str, Any], to: Path, bar: Bar) -> None:
    (to / "blobs" / "sha256").mkdir(parents=True)
    for described in index["manifests"]:
        _, manifest = there.document(described["digest"])
        (to / _blob(described["digest"])).write_bytes(manifest)
        document = json.loads(manifest)
        parts = [document["config"], *document["layers"]]
        for i, part in enumerate(parts):
            bar(i / len(parts), part.get("annotations", {}).get(TITLE, "configuration"))
            there.fetch(part, to / _blob(part["digest"]))
    (to / "oci-layout").write_bytes(canonical_bytes(dict(LAYOUT)))
    (to / "index.json").write_bytes(canonical_bytes(dict(index)))


def _descriptor(media_type: str, data: bytes) -> dict[str, JsonValue]:
    return {
        "mediaType": media_type,
        "digest": f"sha256:{digest_of_bytes(data)}",
        "size": len(data),
    }


def _blob(digest: str) -> str:
    """Returns where an image layout keeps a blob. Raises OciRefused for another kind of digest."""
    kind, _, digits = digest.partition(":")
    if kind != "sha256" or len(digits) != 64 or not set(digits) <= set("0123456789abcdef"):  # noqa: PLR2004
        raise OciRefused(f"{digest!r} is no SHA-256", hint="Push it again.")
    return f"blobs/sha256/{digits}"


@dataclass(frozen=True)
class _Layout:
    """An image layout in a folder, or in a tar file of one."""

    folder: Path
    tar: tarfile.TarFile | None

    def read(self, name: str) -> bytes:
        """Returns a file of it."""
        with self.file(name) as path:
            return path.read_bytes()

    @contextmanager
    def file(self, name: str) -> Iterator[Path]:
        """Yields a file of it, which out of a tar file lasts as long as it is used."""
        if self.tar is None:
            yield self.folder / name
            return
        with tempfile.NamedTemporaryFile() as copy:
            member = self.tar.extractfile(name)
            while member and (part := member.read(PART)):
                copy.write(part)
            copy.flush()
            yield Path(copy.name)


@contextmanager
def _layout(source: Path) -> Iterator[_Layout]:
    """Yields an archive to read. Raises NotExportable."""
    try:
        if source.is_dir():
            yield _Layout(source, None)
            return
        with tarfile.open(source, "r:") as tar:
            yield _Layout(source, tar)
    except (tarfile.TarError, KeyError, FileNotFoundError) as error:
        raise NotExportable(
            f"{source} is no whole archive: {error}",
            hint="Name a model's folder, or an archive by `trueup export` or `trueup backup`.",
        ) from error


@dataclass(frozen=True)
class _Registry:
    """A repository of a registry, by the client of the oras project."""

    client: Any
    container: Any
    host: str

    @property
    def tagged(self) -> str:
        """The tag or the digest that the reference names."""
        return str(self.container.digest or self.container.tag)

    def send(self, described: Mapping[str, Any], path: Path) -> None:
        """Sends a blob, unless it is there."""
        size = int(described["size"])
        answer = self.client.upload_blob(
            str(path), self.container, dict(described), do_chunked=size > AT_ONCE
        )
        self._require(answer, f"blob {described['digest']}")

    def put(self, name: str, media_type: str, content: bytes) -> str:
        """Writes a manifest or an index under a tag or its digest, which is returned."""
        answer = self._ask("PUT", name, data=content, headers={"Content-Type": media_type})
        self._require(answer, f"manifest {name}")
        return digest_of_bytes(content)

    def document(self, name: str) -> tuple[str, bytes]:
        """Returns the media type and the bytes of a manifest or an index, held against their digest
        where that is what names them."""
        answer = self._ask("GET", name, headers={"Accept": f"{IMAGE}, {INDEX}"}, stream=True)
        self._require(answer, f"manifest {name}")
        content = b"".join(answer.iter_content(PART)) if not _is_too_large(answer) else b""
        if not content or len(content) > LARGEST_DOCUMENT:
            raise OciRefused(f"{self.host}: the manifest {name} is empty or too large")
        if name.startswith("sha256:") and name != f"sha256:{digest_of_bytes(content)}":
            raise OciRefused(f"{self.host} sent other bytes than {name} names")
        return str(answer.headers.get("Content-Type", "")).partition(";")[0], content

    def fetch(self, described: Mapping[str, Any], to: Path) -> None:
        """Writes a blob to a file, held against its digest and its size."""
        digest, size = str(described["digest"]), int(described["size"])
        _blob(digest)
        answer = self.client.get_blob(self.container, digest, stream=True)
        self._require(answer, f"blob {digest}")
        hashed, length = hashlib.sha256(), 0
        with to.open("wb") as file:
            for part in answer.iter_content(PART):
                length += len(part)
                if length > size:
                    break
                hashed.update(part)
                file.write(part)
        if length != size or digest != f"sha256:{hashed.hexdigest()}":
            to.unlink()
            raise OciRefused(f"{self.host} sent other bytes than {digest} names")

    def _ask(self, method: str, name: str, **more: Any) -> Any:
        url = f"{self.client.prefix}://{self.container.manifest_url(name)}"
        return self.client.do_request(url, method, **more)

    def _require(self, answer: Any, what: str) -> None:
        """Raises OciRefused where a registry says no."""
        if answer.status_code >= 300:  # noqa: PLR2004
            said = answer.text[:200].replace("\n", " ") if answer.raw is not None else ""
            raise OciRefused(f"{self.host}: {what}: {answer.status_code} {said}".rstrip())


def _is_too_large(answer: Any) -> bool:
    return int(answer.headers.get("Content-Length") or 0) > LARGEST_DOCUMENT


@contextmanager
def _registry(reference: str, *, plain_http: bool) -> Iterator[_Registry]:
    """Yields the repository that a reference names. Raises OciRefused, NotInstalled."""
    try:
        oras = importlib.import_module("oras.client")
        requests = importlib.import_module("requests")
    except ImportError as error:
        raise NotInstalled(
            "an OCI registry is asked by the oras client",
            hint="Install it with `pip install 'trueup[oci]'`.",
        ) from error
    host = reference.partition("/")[0]
    if "/" not in reference or not (":" in host or "." in host or host in LOCAL):
        raise OciRefused(f"{reference} names no registry")
    insecure = plain_http or host.rpartition(":")[0] in LOCAL or host in LOCAL
    client = oras.OrasClient(hostname=host, insecure=insecure)
    client.session.request = partial(client.session.request, timeout=ANSWERS_WITHIN_S)
    # the client's own way is to ask again for minutes, even where the answer is no
    client.do_request = partial(type(client).do_request.__wrapped__, client)
    try:
        container = client.get_container(reference)
        client.auth.load_configs(container)
        yield _Registry(client, container, host)
    except (requests.RequestException, ValueError) as error:
        raise OciRefused(f"{host}: {error}") from error
