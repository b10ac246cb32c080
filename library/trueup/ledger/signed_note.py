"""Signed notes and envelopes: checkpoints of the log as C2SP signed notes, documents in DSSE
envelopes, both signed with Ed25519.

    key          <name>+<hash>+<base64(0x01 || public key)>, hash being the first four bytes of
                 SHA-256(name, newline, 0x01, public key)
    note         text, an empty line, and for each key: "— <name> <base64(hash || signature)>"
    checkpoint   a note of three lines: origin, size of the log, base64 of its root
    endorsement  a note of two lines, by which a key hands over to the next: ENDORSEMENT, and that
                 key
    envelope     {"payload", "payloadType", "signatures"}; what is signed is "DSSEv1", lengths, type
                 and payload (PAE)

Ed25519 signs the same bytes the same way each time, so a document signed again is the same
envelope. Source: C2SP signed-note and tlog-checkpoint; DSSE 1.0, protocol.md; RFC 8032.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
from dataclasses import dataclass
from functools import cached_property

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from trueup.canonical import Json, canonical_bytes
from trueup.errors import TrueupError

ED25519 = b"\x01"
SEED_BYTES = 32
PRIVATE = "PRIVATE+KEY+"
# no checkpoint begins so: an origin has no space
ENDORSEMENT = "trueup: the log is signed from here on by"
_NAME = re.compile(r"[^\s+]+")


class BadKey(TrueupError):
    """The text is no signing key."""

    code = "bad-key"
    hint = (
        "A signing key is one line, PRIVATE+KEY+<name>+<hash>+<key>: make one with `trueup keygen`."
    )


@dataclass(frozen=True)
class Signer:
    """A key with the name of the log that it signs, which is also the checkpoints' origin."""

    name: str
    seed: bytes

    @staticmethod
    def from_text(text: str) -> Signer:
        """A key from its one line of text. Raises BadKey."""
        parts = text.strip().removeprefix(PRIVATE).split("+", 2)
        try:
            name, named, encoded = parts
            key = base64.b64decode(encoded, validate=True)
        except (ValueError, binascii.Error) as error:
            raise BadKey from error
        if (
            not text.startswith(PRIVATE)
            or not _NAME.fullmatch(name)
            or len(key) != 1 + SEED_BYTES
            or key[:1] != ED25519
        ):
            raise BadKey
        signer = Signer(name, key[1:])
        if signer.hash.hex() != named:
            raise BadKey("the key is not the one that its hash names")
        return signer

    @property
    def text(self) -> str:
        """The private key as one line."""
        return f"{PRIVATE}{self.name}+{self.hash.hex()}+{_base64(ED25519 + self.seed)}"

    @property
    def verifier(self) -> str:
        """The public key as one line."""
        return f"{self.name}+{self.hash.hex()}+{_base64(ED25519 + self._public)}"

    @property
    def key_id(self) -> str:
        """The key's name and hash."""
        return f"{self.name}+{self.hash.hex()}"

    @cached_property
    def hash(self) -> bytes:
        """The first bytes of the hash of name and public key, by which a signature names its
        key."""
        return hashlib.sha256(self.name.encode() + b"\n" + ED25519 + self._public).digest()[:4]

    @cached_property
    def _key(self) -> Ed25519PrivateKey:
        return Ed25519PrivateKey.from_private_bytes(self.seed)

    @cached_property
    def _public(self) -> bytes:
        return self._key.public_key().public_bytes_raw()

    def note(self, text: str) -> str:
        """The signed note of a text, which must end in a newline."""
        return f"{text}\n— {self.name} {_base64(self.hash + self._key.sign(text.encode()))}\n"

    def checkpoint(self, size: int, root: bytes) -> str:
        """The state of the log as a signed note."""
        return self.note(f"{self.name}\n{size}\n{_base64(root)}\n")

    def endorsement(self, verifier: str) -> str:
        """A signed note by which this key hands the log over to another one."""
        return self.note(f"{ENDORSEMENT}\n{verifier}\n")

    def envelope(self, payload_type: str, document: Json) -> dict[str, Json]:
        """A document, canonical, in a DSSE envelope."""
        payload = canonical_bytes(document)
        signature = self._key.sign(
            b"DSSEv1 %d %s %d %s"
            % (len(payload_type), payload_type.encode(), len(payload), payload)
        )
        return {
            "payload": _base64(payload),
            "payloadType": payload_type,
            "signatures": [{"keyid": self.key_id, "sig": _base64(signature)}],
        }


def signed_with(note: str, verifier: str) -> bool:
    """Whether a note is signed by a public key."""
    text, _, lines = note.rpartition("\n\n")
    try:
        name, hashed, encoded = verifier.split("+", 2)
        key = base64.b64decode(encoded, validate=True)
        for line in lines.splitlines():
            dash, signer, signature = line.split(" ")
            signed = base64.b64decode(signature, validate=True)
            if (dash, signer, signed[:4].hex()) == ("—", name, hashed):
                Ed25519PublicKey.from_public_bytes(key[1:]).verify(signed[4:], f"{text}\n".encode())
                return True
    except (ValueError, binascii.Error, InvalidSignature):
        return False
    return False


def head_of(note: str) -> tuple[int, bytes]:
    """Size and root of the log in a checkpoint. The caller has verified its signature, or made
    it."""
    _, size, root, *_ = note.splitlines()
    return int(size), base64.b64decode(root)


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
