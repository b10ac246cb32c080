"""Read what a log's service signed and proves: checkpoints, envelopes, inclusion, consistency. The
standard library alone.

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
    """A public key: whose, and the bytes."""

    name: str
    hash: bytes
    public: bytes

    @property
    def text(self) -> str:
        """The key as one line."""
        return f"{self.name}+{self.hash.hex()}+{base64.b64encode(ED25519 + self.public).decode()}"

    @staticmethod
    def from_text(text: str) -> Key:
        """A key as the service gives it, `<name>+<hash>+<key>`. Raises NotSigned."""
        try:
            name, named, encoded = text.strip().split("+", 2)
            data = base64.b64decode(encoded, validate=True)
            found = Key(name, bytes.fromhex(named), data[1:])
        except (ValueError, binascii.Error) as error:
            raise NotSigned("the key is no <name>+<hash>+<key>") from error
        hashed = hashlib.sha256(name.encode() + b"\n" + data).digest()[:KEY_HASH_BYTES]
        if data[:1] != ED25519 or hashed != found.hash:
            raise NotSigned("the key is no Ed25519 key, or not the one that its hash names")
        return found

    def opened(self, note: str) -> str:
        """The text of a signed note, if this key signed it. Raises NotSigned."""
        text, found, lines = note.rpartition("\n\n")
        for line in lines.splitlines() if found else []:
            dash, _, rest = line.partition(" ")
            name, _, encoded = rest.partition(" ")
            signature = _bytes(encoded)
            if (dash, name, signature[:KEY_HASH_BYTES]) == ("—", self.name, self.hash):
                if ed25519.holds(self.public, signature[KEY_HASH_BYTES:], f"{text}\n".encode()):
                    return f"{text}\n"
                break
        raise NotSigned(f"the note is not signed by {self.name}")

    def signed(self, note: str, text: str) -> bool:
        """Whether this key signed a note of this very text."""
        try:
            return self.opened(note) == text
        except NotSigned:
            return False

    def followed(self, endorsements: Iterable[str]) -> list[Key]:
        """The keys that take over from this one, in order: each is endorsed by the one before, for
        the same log."""
        found = [self]
        for note in endorsements:
            try:
                first, verifier, *_ = found[-1].opened(note).split("\n")
                then = Key.from_text(verifier)
            except (NotSigned, ValueError):
                continue
            if first == ENDORSEMENT and then.name == self.name:
                found.append(then)
        return found[1:]

    def payload(self, envelope: Envelope, payload_type: str) -> Any:
        """The document in an envelope, if this key signed it as of this type. Raises NotSigned."""
        try:
            data, named = (
                base64.b64decode(envelope["payload"], validate=True),
                envelope["payloadType"],
            )
            signatures = [
                s["sig"]
                for s in envelope["signatures"]
                if s.get("keyid") in (None, f"{self.name}+{self.hash.hex()}")
            ]
            signed = b"DSSEv1 %d %s %d %s" % (len(named.encode()), named.encode(), len(data), data)
            document = json.loads(data)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise NotSigned("the envelope has another form") from error
        if named != payload_type or not any(
            ed25519.holds(self.public, _bytes(s), signed) for s in signatures
        ):
            raise NotSigned(f"the envelope is not signed by {self.name} as {payload_type}")
        return document


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A log at a moment: how many entries it has, and the hash over all of them. `note` is what was
    signed."""

    size: int
    root: bytes
    note: str

    @staticmethod
    def of(note: str, key: Key) -> Checkpoint:
        """A checkpoint signed by the log's key. Raises NotSigned."""
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
    """The hash of an entry's bytes as a leaf."""
    return hashlib.sha256(b"\x00" + entry).digest()


def _node(left: bytes, right: bytes) -> bytes:
    return hashlib.sha256(b"\x01" + left + right).digest()


def includes(root: bytes, size: int, position: int, leaf: bytes, proof: Sequence[bytes]) -> bool:
    """Whether the tree of `size` leaves with this root has this leaf at this position, counted from
    0."""
    if not 0 <= position < size:
        return False
    at, last, found = position, size - 1, leaf
    for part in proof:
        if last == 0:
            return False
        if at & 1 or at == last:
            found = _node(part, found)
            while not at & 1 and at:
                at, last = at >> 1, last >> 1
        else:
            found = _node(found, part)
        at, last = at >> 1, last >> 1
    return last == 0 and found == root


def extends(old: int, old_root: bytes, size: int, root: bytes, proof: Sequence[bytes]) -> bool:
    """Whether the tree of `size` leaves begins with the one of `old`, both given by their roots."""
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
