"""A registry, or one plant of it, as one file: an OCI image layout, every part named by its
SHA-256.

    oci-layout, index.json          what it is, and its manifest
    blobs/sha256/<digest>           the manifest, its configuration, and the layers:
      rows/<table>.jsonl            rows as they are stored
      log/entries.jsonl             entries of the log; of one plant, each with the proof that it is
                                    in the log
      episodes/<digest>.mcap        recordings
      arrays/<digest>.safetensors   what artifacts name
      outputs/<digest>              what jobs left behind

The configuration holds the log's public key, the notes by which earlier keys handed over to it, and
its signed head. Of a whole registry all entries are there, and the tree is rebuilt from them; of
one plant, its own, each proven. It is a folder, or a tar file of one, which is read where it lies:
nothing in it names a path. Source: OCI image-layout and image-manifest specifications, version 1.1.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import os
import tarfile
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from trueup.canonical import Json, canonical_bytes, digest_of_bytes, is_digest
from trueup.errors import TrueupError
from trueup.files import regular
from trueup.ledger.audit import AuditEntry, entry_bytes
from trueup.ledger.merkle import leaf_hash
from trueup.ledger.note import head_of
from trueup.ledger.rows import KEYS, row_name

SCHEMA = "trueup.archive/1"
ARTIFACT = "application/vnd.trueup.archive.v1"
CONFIG, ROWS, ENTRIES = (
    f"{ARTIFACT}.config+json",
    f"{ARTIFACT}.rows+jsonl",
    f"{ARTIFACT}.entries+jsonl",
)
EPISODE, ARRAYS, OUTPUT = (
    "application/vnd.mcap",
    "application/vnd.safetensors",
    "application/octet-stream",
)
MANIFEST, INDEX = (
    "application/vnd.oci.image.manifest.v1+json",
    "application/vnd.oci.image.index.v1+json",
)
SIGNATURE, ENDORSEMENTS = f"{ARTIFACT}.signature", f"{ARTIFACT}.endorsements"
TITLE = "org.opencontainers.image.title"
PART_BYTES = 1 << 20
DOCUMENT_BYTES = 1 << 20
LARGEST_MANIFEST = 4 << 30  # some 300 bytes for each episode
LARGEST_UNSIGNED = 16 << 20  # of a manifest whose signature nobody could check before it was read
LARGEST_EXTENSION = (
    8 << 10
)  # of a tar file's header that only names the next one, or tells its size
HEADER_BYTES = 512
MOST_KEYS, LONGEST_NOTE = (
    100,
    4096,
)  # how often a log's key may have been handed over, and the characters of the note that says so
HELD = ("episodes/", "arrays/", "imported/", "outputs/")  # titles of what rows name
NAMING = (  # columns of tables that name a row of another one
    ("outputs", "job", "jobs"),
    ("decisions", "job", "jobs"),
    ("approvals", "decision", "decisions"),
    ("moves", "decision", "decisions"),
)
LARGEST_LINE = 64 << 20  # of a row: a manifest or a document of 4 MiB, however it is escaped


class BadArchive(TrueupError):
    """The file is no archive, or not whole."""

    code = "bad-archive"
    hint = "Export it again, or fetch another copy: every part is named by its digest."


class ArchiveWriter:
    """Writes an archive: add layers, then `close` with its configuration. A folder keeps what it
    has of an earlier one."""

    def __init__(self, path: Path) -> None:
        self._path, self._layers = path, list[dict[str, Json]]()
        self._tar = (
            tarfile.open(path.with_name(f"{path.name}.part"), "w")  # noqa: SIM115 - closed by close()
            if path.suffix == ".tar"
            else None
        )
        self._there: set[str] = set()
        if self._tar is None:
            (path / "blobs" / "sha256").mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> ArchiveWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._tar is not None:
            self._tar.close()
            self._path.with_name(f"{self._path.name}.part").unlink(missing_ok=True)

    def add(self, title: str, media_type: str, data: bytes) -> None:
        """A layer that fits into memory."""
        self._layers.append(self._blob(media_type, data) | {"annotations": {TITLE: title}})

    def add_parts(
        self, title: str, media_type: str, digest: str, size: int, parts: Iterable[bytes]
    ) -> None:
        """A layer of known digest and size, in parts. Raises BadArchive if it is another."""
        if digest not in self._there and not (self._tar is None and self._file(digest).exists()):
            self._store(digest, size, _Parts(parts, digest))
        self._there.add(digest)
        self._layers.append(_descriptor(media_type, digest, size) | {"annotations": {TITLE: title}})

    def close(self, config: Mapping[str, Json], sign: Callable[[str], str]) -> str:
        """Write the manifest and the index, signed, and make all durable; the digest of the
        manifest."""
        manifest: dict[str, Json] = {
            "schemaVersion": 2,
            "mediaType": MANIFEST,
            "artifactType": ARTIFACT,
            "config": self._blob(CONFIG, canonical_bytes({"schema": SCHEMA, **config})),
            "layers": self._layers,
        }
        described = self._blob(MANIFEST, canonical_bytes(manifest)) | {"artifactType": ARTIFACT}
        described["annotations"] = {
            SIGNATURE: sign(statement_of(str(described["digest"]))),
            ENDORSEMENTS: canonical_bytes(config.get("endorsements", [])).decode(),
        }
        if self._tar is None:
            _sync(self._path / "blobs" / "sha256")
        index: dict[str, Json] = {"schemaVersion": 2, "mediaType": INDEX, "manifests": [described]}
        self._named("oci-layout", canonical_bytes({"imageLayoutVersion": "1.0.0"}))
        self._named("index.json", canonical_bytes(index))
        if self._tar is not None:
            self._tar.close()
            part = self._path.with_name(f"{self._path.name}.part")
            _sync(part)
            part.replace(self._path)
        else:
            _sync(self._path)
        _sync(self._path.parent)
        return str(described["digest"]).removeprefix("sha256:")

    def _blob(self, media_type: str, data: bytes) -> dict[str, Json]:
        digest = digest_of_bytes(data)
        if digest not in self._there:
            self._store(digest, len(data), io.BytesIO(data))
            self._there.add(digest)
        return _descriptor(media_type, digest, len(data))

    def _file(self, digest: str) -> Path:
        return self._path / "blobs" / "sha256" / digest

    def _store(self, digest: str, size: int, data: Any) -> None:
        if self._tar is not None:
            info = tarfile.TarInfo(f"blobs/sha256/{digest}")
            info.size = size
            self._tar.addfile(info, data)
            if data.read(1) or (isinstance(data, _Parts) and not data.holds()):
                raise BadArchive("the bytes are not those of their digest", digest=digest)
            return
        _write(self._file(digest), data)

    def _named(self, name: str, data: bytes) -> None:
        if self._tar is not None:
            info = tarfile.TarInfo(name)
            info.size = len(data)
            self._tar.addfile(info, io.BytesIO(data))
            return
        _write(self._path / name, io.BytesIO(data))


def statement_of(digest: str) -> str:
    """What the site signs of an archive: that this very one, whole and in this order, is its
    own."""
    return f"{SCHEMA}\n{digest}\n"


def _descriptor(media_type: str, digest: str, size: int) -> dict[str, Json]:
    return {"mediaType": media_type, "digest": f"sha256:{digest}", "size": size}


def _write(path: Path, data: Any) -> None:
    beside = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
    try:
        with beside.open("xb") as file:
            while part := data.read(PART_BYTES):
                file.write(part)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class _Parts:
    """Parts as something that is read from, which must have the digest that they were announced
    with."""

    def __init__(self, parts: Iterable[bytes], digest: str) -> None:
        self._parts, self._digest, self._rest, self._hashed = (
            iter(parts),
            digest,
            b"",
            hashlib.sha256(),
        )

    def read(self, length: int = -1) -> bytes:
        while len(self._rest) < length or length < 0:
            part = next(self._parts, b"")
            if not part:
                break
            self._hashed.update(part)
            self._rest += part
        found, self._rest = (
            (self._rest, b"") if length < 0 else (self._rest[:length], self._rest[length:])
        )
        if not self._rest and len(found) < max(length, 1) and not self.holds():
            raise BadArchive("the bytes are not those of their digest", digest=self._digest)
        return found

    def holds(self) -> bool:
        """Whether what was read has the digest."""
        return self._hashed.hexdigest() == self._digest


@dataclass(frozen=True, slots=True)
class Seal:
    """What the outside of an archive says: the digest of its manifest, the site's signature of it,
    and how its key was handed over."""

    digest: str
    signature: str
    endorsements: tuple[str, ...]


class Archive:
    """An archive that is read, and verified as a registry is. Raises BadArchive.

    `signed` is asked about the seal before anything else is read, and says whether it is known to
    be that of a key which is believed; it may raise. What is not known to be signed is not read
    far.
    """

    def __init__(self, path: Path, signed: Callable[[Seal], bool] = lambda _seal: False) -> None:
        self._path = path
        try:
            self._tar = None
            if path.is_file():
                require_plain_tar(path)
                self._tar = tarfile.open(path, "r:")  # noqa: SIM115
            self._members = _members(self._tar, path.stat().st_size) if self._tar else {}
        except (OSError, tarfile.TarError) as error:
            raise BadArchive(f"{path} is neither a folder nor a tar file") from error
        index: Any = self._document(self._named("index.json"))
        try:
            described = next(m for m in index["manifests"] if m.get("artifactType") == ARTIFACT)
            self.digest = str(described["digest"]).removeprefix("sha256:")
            self.signature = str(described["annotations"][SIGNATURE])
            endorsed = self._document(
                str(described["annotations"].get(ENDORSEMENTS, "[]")).encode()
            )
            if len(endorsed) > MOST_KEYS or any(len(str(note)) > LONGEST_NOTE for note in endorsed):
                raise BadArchive(
                    f"it says that its key was handed over {len(endorsed)} times, or in a "
                    "note beyond reason"
                )
            known = signed(Seal(self.digest, self.signature, tuple(map(str, endorsed))))
            size = int(described["size"])
            if not 0 <= size <= (LARGEST_MANIFEST if known else LARGEST_UNSIGNED):
                raise BadArchive(
                    f"the manifest has {size} bytes, and nothing shows who signed it",
                    hint="Give the key that signs it now.",
                )
            manifest: Any = self._document(self._whole(self.digest, size))
            self._layers = {
                layer["annotations"][TITLE]: str(layer["digest"]).removeprefix("sha256:")
                for layer in manifest["layers"]
            }
            self.config: dict[str, Any] = self._document(
                self._whole(str(manifest["config"]["digest"]).removeprefix("sha256:"))
            )
            if self.config["schema"] != SCHEMA:
                raise BadArchive(f"the archive is a {self.config['schema']}")
            self.plant: str | None = self.config["plant"]
            self.endorsements: list[str] = [
                str(note) for note in self.config.get("endorsements", ())
            ]
            self._held = {
                digest for title, digest in self._layers.items() if title.startswith(HELD)
            }
        except (StopIteration, KeyError, TypeError, AttributeError, ValueError) as error:
            raise BadArchive(f"{path} does not describe itself as an archive") from error

    def close(self) -> None:
        """Close the file."""
        if self._tar is not None:
            self._tar.close()

    # -- as a registry that is verified

    def head(self) -> tuple[int, bytes]:
        """The head that the configuration holds; whoever reads it has verified its signature."""
        return head_of(str(self.config["checkpoint"]))

    def entries(self, after: int, until: int) -> Iterator[AuditEntry]:
        """Entries in order."""
        return (entry for entry, _ in self.proven() if after < entry.sequence <= until)

    def proven(self) -> Iterator[tuple[AuditEntry, list[bytes]]]:
        """Entries in order, each with its proof, which is empty where all entries are there."""
        for line in self._lines("log/entries.jsonl"):
            try:
                entry = AuditEntry(**line["entry"])
                if not _is_entry(entry):
                    raise BadArchive(
                        f"an entry of the log has another form: {str(entry.sequence)[:20]}"
                    )
                yield entry, [base64.b64decode(h) for h in line["proof"]]
            except (KeyError, TypeError, ValueError) as error:
                raise BadArchive("an entry of the log has another form") from error

    def nodes(self) -> None:
        """None: the tree is rebuilt."""

    def signer(self) -> str:
        """The key that the archive names, which whoever reads it has verified."""
        return str(self.config["key"])

    def rows(self, table: str) -> Iterator[Mapping[str, Json]]:
        """Rows as they were stored."""
        for row in self.documents(f"rows/{table}.jsonl"):
            if not isinstance(row, dict) or any(
                isinstance(value, dict | list) for value in row.values()
            ):
                raise BadArchive(f"a row of {table} has another form")
            yield row

    def blob(self, digest: str) -> Iterator[bytes]:
        """An episode's or an artifact's bytes in parts."""
        if digest not in self._held:
            raise BadArchive("the archive does not hold what a row names", digest=digest)
        yield from self.part(digest)

    def blobs(self) -> list[str]:
        """Digests of all episodes and arrays."""
        return sorted(self._held)

    def layer(self, title: str) -> str | None:
        """The digest of a layer; None where there is none."""
        return self._layers.get(title)

    def part(self, digest: str) -> Iterator[bytes]:
        """Any layer's bytes in parts, not verified."""
        with self._open(digest) as file:
            while found := file.read(PART_BYTES):
                yield found

    def documents(self, title: str) -> Iterator[Any]:
        """The documents of a layer, which must be what its digest names; none where there is no
        such layer."""
        return self._lines(title) if title in self._layers else iter(())

    def _lines(self, title: str) -> Iterator[Any]:
        digest = self._layers.get(title)
        if digest is None:
            raise BadArchive(f"the archive has no {title}")
        hashed = hashlib.sha256()
        with self._open(digest) as file:
            while line := file.readline(LARGEST_LINE):
                hashed.update(line)
                yield self._document(line, title)
        if hashed.hexdigest() != digest:
            raise BadArchive(f"{title} is not what its digest names", digest=digest)

    def _whole(self, digest: str, size: int = DOCUMENT_BYTES) -> bytes:
        with self._open(digest) as file:
            found = file.read(size)
        if digest_of_bytes(found) != digest:
            raise BadArchive("a part is not what its digest names", digest=digest)
        return found

    def _document(self, data: bytes, title: str = "a document of the archive") -> Any:
        try:
            return json.loads(data)
        except (ValueError, RecursionError) as error:
            raise BadArchive(
                f"{title} is damaged: it is no JSON, or nested beyond reason"
            ) from error

    def _open(self, digest: str) -> BinaryIO:
        if not is_digest(digest):
            raise BadArchive(f"{digest[:80]!r} is no digest")
        return self._member(f"blobs/sha256/{digest}")

    def _named(self, name: str) -> bytes:
        with self._member(name) as file:
            return file.read(DOCUMENT_BYTES)

    def _member(self, name: str) -> BinaryIO:
        try:
            if self._tar is None:
                return regular(self._path / name)
            found: Any = self._tar.extractfile(self._members[name])
        except (OSError, KeyError, tarfile.TarError) as error:
            raise BadArchive(f"the archive has no {name}") from error
        opened: BinaryIO = found
        return opened


def _is_entry(entry: AuditEntry) -> bool:
    texts = entry.at, entry.kind, entry.actor, entry.subject
    return (
        type(entry.sequence) is int
        and all(isinstance(text, str) for text in texts)
        and isinstance(entry.plant, str | None)
        and isinstance(entry.facts, dict)
        and isinstance(entry.rows, dict)
        and all(isinstance(digest, str) for digest in entry.rows.values())
    )


def require_plain_tar(path: Path) -> None:
    """Walk the headers of a tar file before anything makes members of them. Raises BadArchive for
    one that a reader would choke on: a long extension, one for all members, or a size beyond the
    file.
    """
    whole = path.stat().st_size
    with path.open("rb") as file:
        at = 0
        while at + HEADER_BYTES <= whole:
            file.seek(at)
            header = file.read(HEADER_BYTES)
            if not any(header):
                return
            try:
                size, kind = tarfile.nti(header[124:136]), header[156:157]  # type: ignore[attr-defined]
            except tarfile.HeaderError as error:
                raise BadArchive("a header of the tar file cannot be read") from error
            extends = kind in (b"x", b"g", b"L", b"K", b"X")
            if not 0 <= size <= (LARGEST_EXTENSION if extends else whole) or kind == b"g":
                raise BadArchive(
                    f"a header of the tar file says {size} bytes, or speaks for all others"
                )
            at += HEADER_BYTES * (1 - (-size // HEADER_BYTES))


def _members(tar: tarfile.TarFile, size: int) -> dict[str, tarfile.TarInfo]:
    """The files of a tar file of so many bytes, each of which lies in it whole: what a few bytes
    unfold to is not read."""
    found = {}
    for member in tar.getmembers():
        if member.isdir():
            continue
        if (
            not member.isreg()
            or member.sparse is not None
            or member.offset_data + member.size > size
        ):
            raise BadArchive(
                f"{member.name[:80]!r} is no plain file that lies in the tar file whole"
            )
        found[member.name] = member
    return found


def lines(items: Iterable[Mapping[str, Json]]) -> bytes:
    """Documents as JSON lines."""
    return b"".join(canonical_bytes(item) + b"\n" for item in items)


def entry_line(entry: AuditEntry, proof: Iterable[bytes] = ()) -> dict[str, Json]:
    """An entry as a line of an archive."""
    told: dict[str, Json] = {name: getattr(entry, name) for name in AuditEntry.__slots__}
    return {"entry": told, "proof": [base64.b64encode(h).decode() for h in proof]}


Includes = Callable[
    [bytes, int, int, bytes, list[bytes]], bool
]  # root, size, position, leaf, proof


def unproven(archive: Archive, includes: Includes) -> list[int]:
    """Sequence numbers of entries that are not proven to be in the signed log, in order, and of the
    archive's plant."""
    (size, root), last, found = archive.head(), 0, []
    for entry, proof in archive.proven():
        proven = includes(root, size, entry.sequence - 1, leaf_hash(entry_bytes(entry)), proof)
        if not proven or entry.sequence <= last or entry.plant != archive.plant:
            found.append(entry.sequence)
        last = entry.sequence
    return found


def of_others(archive: Archive) -> list[str]:
    """Rows that are not of the archive's plant."""
    return [
        row_name(table, row)
        for table in KEYS
        for row in archive.rows(table)
        if row["name" if table == "plants" else "plant"] != archive.plant
    ]


def dangling(archive: Archive) -> list[str]:
    """Rows that name a job or a decision which is not in the archive: whoever takes them in would
    hang them on another plant's."""
    there = {
        table: {row[key] for row in archive.rows(table)}
        for table, key in (("jobs", "id"), ("decisions", "digest"))
    }
    return [
        row_name(table, row)
        for table, column, of in NAMING
        for row in archive.rows(table)
        if row.get(column) is not None and row[column] not in there[of]
    ]
