"""The log's key, and its signed head, which is published in a file that anybody may mirror and
never taken back.

Each server remembers the last head that it signed, and signs no head that does not extend it.
"""

from __future__ import annotations

import os
import secrets
import threading
import uuid
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from trueup.canonical import Json
from trueup.files import sync, write_durably, write_new
from trueup.ledger.merkle import EMPTY, Frontier, cover, fold
from trueup.ledger.signed_note import Signer, head_of
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.errors import LogRewound, OtherKey
from trueup_service.registry.database import Database
from trueup_service.registry.records import AuditKey
from trueup_service.registry.transaction import ReadTransaction, Transaction, reading, writing
from trueup_service.settings import Settings

PRIVATE_MODE = 0o600  # of files: for their owner alone
KEY_FILE, KEY_FILE_BEFORE, CHECKPOINT_FILE = "signing.key", "signing.key.before", "checkpoint"


class SignedLog:
    """Signs the head of the log."""

    def __init__(self, database: Database, signer: Signer, published: Path) -> None:
        self.signer = signer
        self._database, self._published = database, published
        self._lock = threading.Lock()
        self._last = head_of(published.read_text()) if published.exists() else (0, EMPTY)

    def checkpoint(self) -> str:
        """The signed head of the log now. Raises LogRewound."""
        with self._lock:
            with reading(self._database) as tx:
                tree = tx.log.tree()
                self._require_extends(tx, tree)
            self._last = tree.size, tree.root()
        return self.signer.checkpoint(*self._last)

    def checkpoint_of(self, tx: ReadTransaction, tree: Frontier) -> str:
        """The signed head of the state that a transaction reads. Raises LogRewound."""
        self._require_extends(tx, tree, or_before=True)
        return self.signer.checkpoint(tree.size, tree.root())

    def publish(self) -> None:
        """Write the signed head to its file, if it has moved. Raises LogRewound."""
        note = self.checkpoint()
        if not self._published.exists() or self._published.read_text() != note:
            write_durably(self._published, [note.encode()], PRIVATE_MODE)
            sync(self._published.parent)

    def envelope(self, payload_type: str, document: Json) -> dict[str, Json]:
        """A document in an envelope that is signed with the log's key."""
        return self.signer.envelope(payload_type, document)

    def _require_extends(
        self, tx: ReadTransaction, tree: Frontier, *, or_before: bool = False
    ) -> None:
        """Raises LogRewound where a tree does not extend the last signed head. A state that was
        read before that head was signed is shorter, and sound (`or_before`)."""
        size, root = self._last
        if tree.size < size and or_before:
            size, root = tree.size, tree.root()
        if tree.size < size:
            raise LogRewound(
                f"the log has {tree.size} entries, {size} were published",
                published=size,
                found=tree.size,
            )
        if root_at(tx, size) != root or root_at(tx, tree.size) != tree.root():
            raise LogRewound(
                f"the first {size} entries are not those that were published",
                published=size,
                found=tree.size,
            )


def root_at(tx: ReadTransaction, size: int) -> bytes:
    """The root of the tree when it had this size, which it has reached."""
    nodes = cover(0, size)
    hashes = tx.log.nodes(nodes)
    return fold([hashes.get(node, b"") for node in nodes]) if nodes else EMPTY


def open_log(settings: Settings, database: Database) -> SignedLog:
    """The log with its key. The key is made at the first start, and a new key takes over from the
    one before. Raises BadKey, OtherKey."""
    signer, before = _signers(settings)
    with writing(database) as tx:
        tx.lock_name("audit key")
        keys = tx.log.signing_keys()
        if not keys:
            tx.log.add_key(AuditKey(verifier=signer.verifier, endorsement=None))
        elif keys[-1].verifier != signer.verifier:
            _take_over(tx, keys, signer, before)
    return SignedLog(database, signer, settings.data_dir / CHECKPOINT_FILE)


def own_key(settings: Settings) -> str | None:
    """The public key that signs here, None where there is none yet. Raises BadKey."""
    if settings.signing_key is None and not (settings.data_dir / KEY_FILE).exists():
        return None
    return _signers(settings)[0].verifier


def _signers(settings: Settings) -> tuple[Signer, Signer | None]:
    """The key that signs, and the key that it takes over from where that is at hand."""
    if settings.signing_key is not None:
        before = settings.signing_key_before
        return Signer.from_text(settings.signing_key.get_secret_value()), Signer.from_text(
            before.get_secret_value()
        ) if before else None
    path = settings.data_dir / KEY_FILE_BEFORE
    old = Signer.from_text(path.read_text()) if path.exists() else None
    return Signer.from_text(_key_text(settings.data_dir / KEY_FILE, old.name if old else None)), old


def _take_over(
    tx: Transaction, keys: Sequence[AuditKey], signer: Signer, before: Signer | None
) -> None:
    """Let the key before endorse this one, and record it in the log. Raises OtherKey."""
    known = keys[-1].verifier
    keys_by_place = {"log": known, "server": signer.verifier}
    if before is None or before.verifier != known:
        raise OtherKey(f"the log is signed with {known}", **keys_by_place)
    if before.name != signer.name:
        raise OtherKey(
            f"the log is {before.name!r}, and the key that is to take over is for {signer.name!r}",
            **keys_by_place,
        )
    if signer.verifier in [key.verifier for key in keys]:
        raise OtherKey("the key that is to take over has been replaced before", **keys_by_place)
    endorsement = before.endorsement(signer.verifier)
    tx.log.add_key(AuditKey(verifier=signer.verifier, endorsement=endorsement))
    facts: dict[str, Json] = {"before": known, "endorsement": endorsement}
    tx.log.append(
        ActorContext("server", time_text(datetime.now(UTC))),
        "key:replaced",
        plant=None,
        subject=signer.verifier,
        facts=facts,
    )


def new_signer(name: str | None = None) -> Signer:
    """A fresh key for a log of this name, or of a new random name."""
    return Signer(name or f"trueup-{secrets.token_hex(6)}", secrets.token_bytes(32))


def _key_text(path: Path, name: str | None) -> str:
    """The key of a data folder, made where there is none. Of several processes that start at once,
    one makes it."""
    if not path.exists():
        beside = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
        write_new(beside, f"{new_signer(name).text}\n".encode(), PRIVATE_MODE)
        try:
            os.link(beside, path)
        except FileExistsError:
            pass
        finally:
            beside.unlink()
        sync(path.parent)
    return path.read_text()
