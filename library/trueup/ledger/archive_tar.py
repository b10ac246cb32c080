"""The tar file of an archive, read so that nothing in it unfolds beyond its own size."""

from __future__ import annotations

import tarfile
from pathlib import Path

from trueup.ledger.archive_layout import BadArchive

HEADER_BYTES = 512
# Bytes of a header that only names the next one, or says its size.
LARGEST_EXTENSION = 8 << 10


def require_plain_tar(path: Path) -> None:
    """Walk the headers of a tar file before `tarfile` reads them. Raises BadArchive for one that
    could exhaust memory: a long extension, one for all members, or a size beyond the file.
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


def plain_members(tar: tarfile.TarFile, size: int) -> dict[str, tarfile.TarInfo]:
    """The files in a tar file of `size` bytes by name. Raises BadArchive for one that is sparse or
    does not lie in the tar file whole: a few bytes must not unfold to many."""
    members = {}
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
        members[member.name] = member
    return members
