"""Verifies checkpoints, envelopes and the proofs of inclusion and consistency of a log.

Source: C2SP signed-note and tlog-checkpoint; DSSE 1.0; RFC 9162, sections 2.1.3.2 and 2.1.4.2.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from trueup_client import ed25519
from trueup_client.problem import NotSigned
from trueup_client.records import Envelope

HASH_BYTES, KEY_HASH_BYTES = 32, 4
ED25519 = b"\x01"
ENDORSEMENT = "trueup: the log is signed from here on by"


@dataclass(frozen=True, slots=True)
class Key:
    """A log's public Ed25519 key: the log's name, the key's hash, and its 32 bytes."""

    name: str
    hash: bytes
    public: bytes

    @property
    def text(self) -> str:
        """The key as one line."""
        return f"{self.name}+{self.hash.hex()}+{base64.b64encode(ED25519 + self.public).decode()}"

    @staticmethod
    def from_text(text: str) -> Key:
        """Returns a key from the service's text `<name>+<hash>+<key>`. Raises NotSigned."""
        try:
            name, hash_text, encoded = text.strip().split("+", 2)
            data = base64.b64decode(encoded, validate=True)
            key = Key(name, bytes.fromhex(hash_text), data[1:])
        except (ValueError, binascii.Error) as error:
            raise NotSigned("the key is no <name>+<hash>+<key>") from error
        hashed = hashlib.sha256(name.encode() + b"\n" + data).digest()[:KEY_HASH_BYTES]
        if data[:1] != ED25519 or hashed != key.hash:
            raise NotSigned("the key is no Ed25519 key, or not the one that its hash names")
        return key

    def opened(self, note: str) -> str:
        """Returns the text of a signed note. Raises NotSigned if this key did not sign it."""
        text, separator, lines = note.rpartition("\n\n")
        for line in lines.splitlines() if separator else []:
            dash, _, rest = line.partition(" ")
            name, _, encoded = rest.partition(" ")
            signature = _bytes(encoded)
            if (dash, name, signature[:KEY_HASH_BYTES]) == ("—", self.name, self.hash):
                if ed25519.is_valid(self.public, signature[KEY_HASH_BYTES:], f"{text}\n".encode()):
                    return f"{text}\n"
                break
        raise NotSigned(f"the note is not signed by {self.name}")

    def signed(self, note: str, text: str) -> bool:
        """Whether this key signed the note, and the note says exactly this text."""
        try:
            return self.opened(note) == text
        except NotSigned:
            return False

    def followed(self, endorsements: Iterable[str]) -> list[Key]:
        """Returns the keys that take over from this one, in order.

        Each is endorsed by the one before, for the same log. Other notes are skipped.
        """
        keys = [self]
        for note in endorsements:
            try:
                first, verifier, *_ = keys[-1].opened(note).split("\n")
                successor = Key.from_text(verifier)
            except (NotSigned, ValueError):
                continue
            if first == ENDORSEMENT and successor.name == self.name:
                keys.append(successor)
        return keys[1:]

    def payload(self, envelope: Envelope, payload_type: str) -> Any:
        """Returns the document in an envelope.

        Raises NotSigned if this key did not sign it as of this type.
        """
        try:
            data = base64.b64decode(envelope["payload"], validate=True)
            kind = envelope["payloadType"]
            signatures = [
                s["sig"]
                for s in envelope["signatures"]
                if s.get("keyid") in (None, f"{self.name}+{self.hash.hex()}")
            ]
            signed = b"DSSEv1 %d %s %d %s" % (len(kind.encode()), kind.encode(), len(data), data)
            document = json.loads(data)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise NotSigned("the envelope has another form") from error
        if kind != payload_type or not any(
            ed25519.is_valid(self.public, _bytes(s), signed) for s in signatures
        ):
            raise NotSigned(f"the envelope is not signed by {self.name} as {payload_type}")
        return document


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A log at a moment: how many entries it has, and the root hash over all of them.

    `note` is the signed text.
    """

    size: int
    root: bytes
    note: str

    @staticmethod
    def of(note: str, key: Key) -> Checkpoint:
        """Returns the checkpoint in a note. Raises NotSigned if the log's key did not sign it."""
        lines = key.opened(note).split("\n")
        root = _bytes(lines[2]) if len(lines) >= 3 else b""  # noqa: PLR2004  (origin, size, root)
        if len(root) != HASH_BYTES or lines[0] != key.name or not lines[1].isdigit():
            raise NotSigned("the note is no checkpoint of this log")
        return Checkpoint(int(lines[1]), root, note)


def _bytes(encoded: object) -> bytes:
    try:
        return base64.b64decode(str(encoded), validate=True)
    except (ValueError, binascii.Error):
        return b""


def leaf_hash(entry: bytes) -> bytes:
    """Returns the hash of an entry's bytes as a leaf of the tree."""
    return hashlib.sha256(b"\x00" + entry).digest()


def _node(left: bytes, right: bytes) -> bytes:
    return hashlib.sha256(b"\x01" + left + right).digest()


def includes(root: bytes, size: int, position: int, leaf: bytes, proof: Sequence[bytes]) -> bool:
    """Whether the tree of `size` leaves has this leaf at this position, counted from 0.

    Source: RFC 9162, section 2.1.3.2.
    """
    if not 0 <= position < size:
        return False
    at, last, node = position, size - 1, leaf
    for part in proof:
        if last == 0:
            return False
        if at & 1 or at == last:
            node = _node(part, node)
            while not at & 1 and at:
                at, last = at >> 1, last >> 1
        else:
            node = _node(node, part)
        at, last = at >> 1, last >> 1
    return last == 0 and node == root


def extends(old: int, old_root: bytes, size: int, root: bytes, proof: Sequence[bytes]) -> bool:
    """Whether the tree of `size` leaves extends the one of `old` leaves, both named by their roots.

    Source: RFC 9162, section 2.1.4.2.
    """
    if old > size:
        return False
    if old in (0, size):
        return not proof and (old == 0 or old_root == root)
    path = list(proof) if old & (old - 1) else [old_root, *proof]
    if not path:
        return False
    at, last = old - 1, size - 1
    while at & 1:
        at, last = at >> 1, last >> 1
    before = after = path[0]
    for part in path[1:]:
        if last == 0:
            return False
        if at & 1 or at == last:
            before, after = _node(part, before), _node(part, after)
            while not at & 1 and at:
                at, last = at >> 1, last >> 1
        else:
            after = _node(after, part)
        at, last = at >> 1, last >> 1
    return last == 0 and before == old_root and after == root
