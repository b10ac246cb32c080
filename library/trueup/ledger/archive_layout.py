"""The form of an archive: a registry, or one plant of it, as one file. It is an OCI image layout,
every part named by its SHA-256.

    oci-layout, index.json          what it is, and its manifest
    blobs/sha256/<digest>           the manifest, its configuration, and the layers:
      rows/<table>.jsonl            rows as they are stored
      log/entries.jsonl             entries of the log; of one plant, each with its inclusion proof
      episodes/<digest>.mcap        recordings
      arrays/<digest>.safetensors   what artifacts name
      outputs/<digest>              what jobs left behind

The configuration holds the log's public key, the notes by which earlier keys handed over to it, and
its signed head. An archive of a whole registry has all entries, and the tree is rebuilt from them;
one of a plant has the plant's entries, each proven. It is a folder, or a tar file of one, which is
read where it lies: nothing in it names a path. Source: OCI image-layout and image-manifest
specifications, version 1.1.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping

from trueup.canonical import Json, canonical_bytes
from trueup.errors import TrueupError
from trueup.ledger.audit import AuditEntry

SCHEMA = "trueup.archive/1"
ARTIFACT = "application/vnd.trueup.archive.v1"
CONFIG = f"{ARTIFACT}.config+json"
ROWS = f"{ARTIFACT}.rows+jsonl"
ENTRIES = f"{ARTIFACT}.entries+jsonl"
EPISODE = "application/vnd.mcap"
ARRAYS = "application/vnd.safetensors"
OUTPUT = "application/octet-stream"
MANIFEST = "application/vnd.oci.image.manifest.v1+json"
INDEX = "application/vnd.oci.image.index.v1+json"
SIGNATURE, ENDORSEMENTS = f"{ARTIFACT}.signature", f"{ARTIFACT}.endorsements"
TITLE = "org.opencontainers.image.title"
PART_BYTES = 1 << 20


class BadArchive(TrueupError):
    """The file is no archive, or not whole."""

    code = "bad-archive"
    hint = "Export it again, or fetch another copy: every part is named by its digest."


def statement_of(digest: str) -> str:
    """The text that the site signs of an archive: its manifest's digest, which covers every part
    and their order."""
    return f"{SCHEMA}\n{digest}\n"


def lines(items: Iterable[Mapping[str, Json]]) -> bytes:
    """Documents as JSON lines."""
    return b"".join(canonical_bytes(item) + b"\n" for item in items)


def entry_line(entry: AuditEntry, proof: Iterable[bytes] = ()) -> dict[str, Json]:
    """An entry of the log, with its inclusion proof, as a line of an archive."""
    document: dict[str, Json] = {name: getattr(entry, name) for name in AuditEntry.__slots__}
    return {"entry": document, "proof": [base64.b64encode(h).decode() for h in proof]}
