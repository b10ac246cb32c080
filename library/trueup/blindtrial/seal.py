"""Seal: a label committed before the diagnosis and opened after it.

A commitment is the SHA-256 of the canonical bytes of a label and its salt: it binds the label and,
as long as the salt is not known, tells nothing of it. Labels and salts follow from one secret, so
that whoever is given it afterwards can draw everything again. Source: M. Naor, Journal of
Cryptology 4 (1991), on bit commitment.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.canonical import Json, canonical_bytes, digest_of, digest_of_bytes
from trueup.errors import TrueupError


class LabelLeaked(TrueupError):
    """What is handed to the diagnosis tells the label."""

    code = "label-leaked"
    hint = "Take the named file's metadata out of the recordings; then draw again."


class NotAsCommitted(TrueupError):
    """An opened label is not the one that was committed."""

    code = "not-as-committed"
    hint = (
        "The report was edited, or is not of this trial: compare its commitments with those "
        "in the audit log."
    )


def salt_of(secret: bytes, index: int) -> str:
    """A trial's salt, 64 hexadecimal digits."""
    return digest_of_bytes(secret + b"/salt/" + str(index).encode())


def commitment(label: Mapping[str, Json], salt: str) -> str:
    """What is published before the diagnosis."""
    return digest_of({"label": label, "salt": salt})


def require_silent(
    files: Mapping[str, bytes], label: Mapping[str, Any], salt: str, own: Json
) -> None:
    """Raises LabelLeaked where a file's name or bytes spell an effect or the salt; words of the
    user's `own` documents are not told."""
    hidden = [*label["effects"], *([label["bait"]] if label["bait"] else ())]
    words = {*(name.split(" at ")[0] for name in hidden), salt}
    known = canonical_bytes(own).decode()
    for name, data in files.items():
        for word in words:
            if word not in known and (word in name or word.encode() in data):
                raise LabelLeaked(
                    f"{name} spells {word if word != salt else 'the salt'!r}", file=name
                )


def require_as_committed(document: Mapping[str, Any], commitments: list[str]) -> None:
    """Hold a report's opened labels against what was published. Raises NotAsCommitted."""
    rows = document["rows"]
    if len(rows) != len(commitments):
        raise NotAsCommitted(f"{len(commitments)} labels were committed, {len(rows)} were opened")
    for row, published in zip(rows, commitments, strict=True):
        if commitment(row["label"], row["salt"]) != published:
            raise NotAsCommitted(
                f"the label of trial {row['index']} is not the one committed", trial=row["index"]
            )
