"""Writing an archive, as a folder or as a tar file."""

from __future__ import annotations

import hashlib
import io
import tarfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from trueup.canonical import Json, canonical_bytes, digest_of_bytes
from trueup.files import sync, write_durably
from trueup.ledger.archive_layout import (
    ARTIFACT,
    CONFIG,
    ENDORSEMENTS,
    INDEX,
    MANIFEST,
    PART_BYTES,
    SCHEMA,
    SIGNATURE,
    TITLE,
    BadArchive,
    statement_of,
)


class ArchiveWriter:
    """Writes an archive: add layers, then `close` it with its configuration. Into a folder, parts
    that an earlier archive left there are not written again."""

    def __init__(self, path: Path) -> None:
        self._path, self._layers = path, list[dict[str, Json]]()
        self._tar = (
            tarfile.open(path.with_name(f"{path.name}.part"), "w")  # noqa: SIM115 - closed by close()
            if path.suffix == ".tar"
            else None
        )
        self._written: set[str] = set()
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
        """Add a layer that fits into memory."""
        self._layers.append(self._blob(media_type, data) | {"annotations": {TITLE: title}})

    def add_parts(
        self, title: str, media_type: str, digest: str, size: int, parts: Iterable[bytes]
    ) -> None:
        """Add a layer of known digest and size, in parts. Raises BadArchive if the parts have
        another digest or size."""
        if digest not in self._written and not (self._tar is None and self._file(digest).exists()):
            self._store(digest, size, _HashedStream(parts, digest))
        self._written.add(digest)
        self._layers.append(_descriptor(media_type, digest, size) | {"annotations": {TITLE: title}})

    def close(self, config: Mapping[str, Json], sign: Callable[[str], str]) -> str:
        """Write the signed manifest and the index, make everything durable, and return the digest
        of the manifest."""
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
            sync(self._path / "blobs" / "sha256")
        index: dict[str, Json] = {"schemaVersion": 2, "mediaType": INDEX, "manifests": [described]}
        self._named("oci-layout", canonical_bytes({"imageLayoutVersion": "1.0.0"}))
        self._named("index.json", canonical_bytes(index))
        if self._tar is not None:
            self._tar.close()
            part = self._path.with_name(f"{self._path.name}.part")
            sync(part)
            part.replace(self._path)
        else:
            sync(self._path)
        sync(self._path.parent)
        return str(described["digest"]).removeprefix("sha256:")

    def _blob(self, media_type: str, data: bytes) -> dict[str, Json]:
        digest = digest_of_bytes(data)
        if digest not in self._written:
            self._store(digest, len(data), io.BytesIO(data))
            self._written.add(digest)
        return _descriptor(media_type, digest, len(data))

    def _file(self, digest: str) -> Path:
        return self._path / "blobs" / "sha256" / digest

    def _store(self, digest: str, size: int, data: Any) -> None:
        if self._tar is not None:
            info = tarfile.TarInfo(f"blobs/sha256/{digest}")
            info.size = size
            self._tar.addfile(info, data)
            if data.read(1) or (isinstance(data, _HashedStream) and not data.holds()):
                raise BadArchive("the bytes are not those of their digest", digest=digest)
            return
        write_durably(self._file(digest), _chunks(data))

    def _named(self, name: str, data: bytes) -> None:
        if self._tar is not None:
            info = tarfile.TarInfo(name)
            info.size = len(data)
            self._tar.addfile(info, io.BytesIO(data))
            return
        write_durably(self._path / name, [data])


def _descriptor(media_type: str, digest: str, size: int) -> dict[str, Json]:
    return {"mediaType": media_type, "digest": f"sha256:{digest}", "size": size}


def _chunks(stream: Any) -> Iterator[bytes]:
    while chunk := stream.read(PART_BYTES):
        yield chunk


class _HashedStream:
    """Parts as a readable stream. Reading to its end raises BadArchive unless the bytes have the
    announced digest."""

    def __init__(self, parts: Iterable[bytes], digest: str) -> None:
        self._parts, self._digest = iter(parts), digest
        self._rest, self._hashed = b"", hashlib.sha256()

    def read(self, length: int = -1) -> bytes:
        """Up to `length` bytes, or all that are left. Raises BadArchive."""
        while len(self._rest) < length or length < 0:
            part = next(self._parts, b"")
            if not part:
                break
            self._hashed.update(part)
            self._rest += part
        data, self._rest = (
            (self._rest, b"") if length < 0 else (self._rest[:length], self._rest[length:])
        )
        if not self._rest and len(data) < max(length, 1) and not self.holds():
            raise BadArchive("the bytes are not those of their digest", digest=self._digest)
        return data

    def holds(self) -> bool:
        """Whether the bytes read so far have the digest."""
        return self._hashed.hexdigest() == self._digest
