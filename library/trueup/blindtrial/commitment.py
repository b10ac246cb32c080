"""Commitment: a label is committed before the diagnosis and opened after it.

A commitment is the SHA-256 of the canonical bytes of a label and its salt. It binds the label and
reveals nothing of it as long as the salt is not known. Labels and salts follow from one secret,
with which everything can be drawn again. Source: M. Naor, Journal of Cryptology 4 (1991), on bit
commitment.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.canonical import Json, canonical_bytes, digest_of, digest_of_bytes
from trueup.errors import TrueupError


class LabelLeaked(TrueupError):
    """What is handed to the diagnosis reveals the label."""

    code = "label-leaked"
    hint = "Take the named file's metadata out of the recordings; then draw again."


class CommitmentMismatch(TrueupError):
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
    """The commitment of a label, 64 hexadecimal digits: what is published before the diagnosis."""
    return digest_of({"label": label, "salt": salt})


def require_no_leak(
    files: Mapping[str, bytes], label: Mapping[str, Any], salt: str, own: Json
) -> None:
    """Raises LabelLeaked where a file's name or bytes spell an effect of the label, or the salt.

    Words that the user's `own` documents hold are no leak.
    """
    hidden = [*label["effects"], *([label["bait"]] if label["bait"] else ())]
    words = {*(name.split(" at ")[0] for name in hidden), salt}
    known = canonical_bytes(own).decode()
    for name, data in files.items():
        for word in words:
            if word not in known and (word in name or word.encode() in data):
                raise LabelLeaked(
                    f"{name} spells {word if word != salt else 'the salt'!r}", file=name
                )


def require_commitments(document: Mapping[str, Any], commitments: list[str]) -> None:
    """Raises CommitmentMismatch where a report's opened labels are not those of the published
    commitments."""
    rows = document["rows"]
    if len(rows) != len(commitments):
        raise CommitmentMismatch(
            f"{len(commitments)} labels were committed, {len(rows)} were opened"
        )
    for row, published in zip(rows, commitments, strict=True):
        if commitment(row["label"], row["salt"]) != published:
            raise CommitmentMismatch(
                f"the label of trial {row['index']} is not the one committed", trial=row["index"]
            )
