"""Reading an archive, whose form is in `archive_layout`, and checking that an archive of one plant
holds the plant's own rows and entries alone."""

from __future__ import annotations

import base64
import hashlib
import json
import tarfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from trueup.canonical import Json, digest_of_bytes, is_digest
from trueup.files import regular
from trueup.ledger.archive_layout import (
    ARTIFACT,
    ENDORSEMENTS,
    PART_BYTES,
    SCHEMA,
    SIGNATURE,
    TITLE,
    BadArchive,
)
from trueup.ledger.archive_tar import plain_members, require_plain_tar
from trueup.ledger.audit import AuditEntry, entry_bytes
from trueup.ledger.merkle import leaf_hash
from trueup.ledger.rows import KEYS, row_name
from trueup.ledger.signed_note import head_of

DOCUMENT_BYTES = 1 << 20
LARGEST_MANIFEST = 4 << 30  # some 300 bytes for each episode
LARGEST_UNSIGNED = 16 << 20  # of a manifest whose signature nobody could check before it was read
LARGEST_LINE = 64 << 20  # of a row: a manifest or a document of 4 MiB, however it is escaped
MOST_KEYS = 100  # how often a log's key may have been handed over,
LONGEST_NOTE = 4096  # and the characters of the note that says so
BLOBS = ("episodes/", "arrays/", "imported/", "outputs/")  # titles of the layers that rows name
# Columns that name a row of another table: table, column, table of the named row.
NAMING = (
    ("outputs", "job", "jobs"),
    ("decisions", "job", "jobs"),
    ("approvals", "decision", "decisions"),
    ("moves", "decision", "decisions"),
)


@dataclass(frozen=True, slots=True)
class ManifestSignature:
    """What the index of an archive says of its manifest: its digest, the site's signature of it,
    and the notes by which the site's key was handed over."""

    digest: str
    signature: str
    endorsements: tuple[str, ...]


class Archive:
    """An archive that is read; it is verified as a registry is. Raises BadArchive.

    `signed` gets the manifest's signature before anything else is read, and says whether it is by a
    key that is believed; it may raise. Of an archive that is not known to be signed, only a small
    manifest is read.
    """

    def __init__(
        self, path: Path, signed: Callable[[ManifestSignature], bool] = lambda _signature: False
    ) -> None:
        self._path = path
        try:
            self._tar = None
            if path.is_file():
                require_plain_tar(path)
                self._tar = tarfile.open(path, "r:")  # noqa: SIM115
            self._members = plain_members(self._tar, path.stat().st_size) if self._tar else {}
        except (OSError, tarfile.TarError) as error:
            raise BadArchive(f"{path} is neither a folder nor a tar file") from error
        index: Any = self._document(self._named("index.json"))
        try:
            described = next(m for m in index["manifests"] if m.get("artifactType") == ARTIFACT)
            manifest_signature = self._manifest_signature(described)
            self.digest, self.signature = manifest_signature.digest, manifest_signature.signature
            manifest = self._manifest(int(described["size"]), known=signed(manifest_signature))
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
            self._blobs = {
                digest for title, digest in self._layers.items() if title.startswith(BLOBS)
            }
        except (StopIteration, KeyError, TypeError, AttributeError, ValueError) as error:
            raise BadArchive(f"{path} does not describe itself as an archive") from error

    def _manifest_signature(self, described: Any) -> ManifestSignature:
        endorsements = self._document(
            str(described["annotations"].get(ENDORSEMENTS, "[]")).encode()
        )
        if len(endorsements) > MOST_KEYS or any(
            len(str(note)) > LONGEST_NOTE for note in endorsements
        ):
            raise BadArchive(
                f"it says that its key was handed over {len(endorsements)} times, or in a "
                "note beyond reason"
            )
        return ManifestSignature(
            str(described["digest"]).removeprefix("sha256:"),
            str(described["annotations"][SIGNATURE]),
            tuple(map(str, endorsements)),
        )

    def _manifest(self, size: int, *, known: bool) -> Any:
        """The manifest of `size` bytes; `known` says that its signature is by a key that is
        believed."""
        if size < 0:
            raise BadArchive(f"the manifest says that it has {size} bytes")
        if size > LARGEST_MANIFEST:
            raise BadArchive(f"the manifest has {size} bytes, {LARGEST_MANIFEST} are allowed")
        if size > LARGEST_UNSIGNED and not known:
            raise BadArchive(
                f"the manifest has {size} bytes, and nothing shows who signed it",
                hint="Give the key that signs it now.",
            )
        return self._document(self._whole(self.digest, size))

    def close(self) -> None:
        """Close the tar file, if it is one."""
        if self._tar is not None:
            self._tar.close()

    # -- as the Registry that `verification` reads

    def head(self) -> tuple[int, bytes]:
        """Size and root of the log, as the configuration holds them. The caller has verified their
        signature."""
        return head_of(str(self.config["checkpoint"]))

    def entries(self, after: int, until: int) -> Iterator[AuditEntry]:
        """Entries in order, from behind `after` up to `until`."""
        return (entry for entry, _ in self.entries_with_proofs() if after < entry.sequence <= until)

    def entries_with_proofs(self) -> Iterator[tuple[AuditEntry, list[bytes]]]:
        """Entries in order, each with its inclusion proof, which is empty in an archive of a whole
        registry."""
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
        """None: an archive keeps no hashes, and the tree is rebuilt."""

    def signer(self) -> str:
        """The public key that the archive names. The caller has verified that it is believed."""
        return str(self.config["key"])

    def rows(self, table: str) -> Iterator[Mapping[str, Json]]:
        """Rows of a table, as they were stored. Raises BadArchive."""
        for row in self.documents(f"rows/{table}.jsonl"):
            if not isinstance(row, dict) or any(
                isinstance(value, dict | list) for value in row.values()
            ):
                raise BadArchive(f"a row of {table} has another form")
            yield row

    def blob(self, digest: str) -> Iterator[bytes]:
        """The bytes of an episode, an array or an output, in parts. Raises BadArchive where the
        archive does not hold them."""
        if digest not in self._blobs:
            raise BadArchive("the archive does not hold what a row names", digest=digest)
        yield from self.part(digest)

    def blobs(self) -> list[str]:
        """Digests of all episodes, arrays and outputs."""
        return sorted(self._blobs)

    def layer(self, title: str) -> str | None:
        """The digest of a layer; None where there is none."""
        return self._layers.get(title)

    def part(self, digest: str) -> Iterator[bytes]:
        """Any layer's bytes in parts, not verified."""
        with self._open(digest) as file:
            while part := file.read(PART_BYTES):
                yield part

    def documents(self, title: str) -> Iterator[Any]:
        """The documents of a layer; none where there is no such layer. Raises BadArchive where the
        layer is not what its digest names."""
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
            data = file.read(size)
        if digest_of_bytes(data) != digest:
            raise BadArchive("a part is not what its digest names", digest=digest)
        return data

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
            member: Any = self._tar.extractfile(self._members[name])
        except (OSError, KeyError, tarfile.TarError) as error:
            raise BadArchive(f"the archive has no {name}") from error
        stream: BinaryIO = member
        return stream


def _is_entry(entry: AuditEntry) -> bool:
    """Whether every field of an entry has its type."""
    texts = entry.at, entry.kind, entry.actor, entry.subject
    return (
        type(entry.sequence) is int
        and all(isinstance(text, str) for text in texts)
        and isinstance(entry.plant, str | None)
        and isinstance(entry.facts, dict)
        and isinstance(entry.rows, dict)
        and all(isinstance(digest, str) for digest in entry.rows.values())
    )


# Whether a leaf is in a tree: root, size, position, leaf, proof.
Includes = Callable[[bytes, int, int, bytes, list[bytes]], bool]


def unproven(archive: Archive, includes: Includes) -> list[int]:
    """Sequence numbers of the entries that are out of order, of another plant than the archive's,
    or not proven to be in the signed log."""
    (size, root), last, refused = archive.head(), 0, []
    for entry, proof in archive.entries_with_proofs():
        proven = includes(root, size, entry.sequence - 1, leaf_hash(entry_bytes(entry)), proof)
        if not proven or entry.sequence <= last or entry.plant != archive.plant:
            refused.append(entry.sequence)
        last = entry.sequence
    return refused


def foreign_rows(archive: Archive) -> list[str]:
    """Names of the rows that are not of the archive's plant."""
    return [
        row_name(table, row)
        for table in KEYS
        for row in archive.rows(table)
        if row["name" if table == "plants" else "plant"] != archive.plant
    ]


def dangling_rows(archive: Archive) -> list[str]:
    """Names of the rows that name a job or a decision which is not in the archive. Importing them
    would tie them to another plant's."""
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
