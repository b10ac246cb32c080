"""A client as a witness of the log: it keeps the last checkpoint, and refuses a log that does not
extend it.

The file holds the checkpoint and the log's public key, which is pinned at the first look unless it
was passed. If the log has another key by now, the witness follows the chain of endorsements from
the pinned key to it. Many witnesses who never talk to each other still make it costly to show each
of them another history, because each refuses what does not extend its own.
"""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeAlias, TypeVar

from trueup_client.problem import LogForked, NotSigned, Problem
from trueup_client.proof import Checkpoint, Key, extends

T = TypeVar("T")
# returns the notes by which keys handed over; called if the pinned key did not sign
Endorsements: TypeAlias = "Callable[[], Iterable[str]]"
BAD_REQUEST = 400  # the HTTP status of a log that is shorter than it was
# returns the proof that a log of the second size extends one of the first
Proof: TypeAlias = "Callable[[int, int], Sequence[bytes]]"


class Witness:
    """The last checkpoint of one log and the keys to trust, in a file.

    `key` is the log's public key from its operator, and trusted from then on. Without it the first
    key seen is trusted.
    """

    def __init__(self, path: str | os.PathLike[str], key: str | None = None) -> None:
        self._path = Path(path)
        stored = json.loads(self._path.read_text()) if self._path.exists() else {}
        # the last one is the key to trust
        texts = [*stored.get("before", []), stored.get("key")]
        self.keys = [Key.from_text(text) for text in texts if text]
        self.last: Checkpoint | None = (
            Checkpoint.of(stored["checkpoint"], self.keys[-1]) if "checkpoint" in stored else None
        )
        if key is not None and Key.from_text(key) not in self.keys:
            self.keys.append(Key.from_text(key))

    @property
    def key(self) -> Key | None:
        """The key to trust; None before one was pinned."""
        return self.keys[-1] if self.keys else None

    def pin(self, key: str) -> Key:
        """Pins this key if none is pinned yet, and returns it.

        Raises NotSigned if another one is pinned.
        """
        offered = Key.from_text(key)
        self.keys = self.keys or [offered]
        if offered != self.keys[-1]:
            raise NotSigned(f"the log is signed by another key than the one pinned in {self._path}")
        return offered

    def believed(self, read: Callable[[Key], T], endorsements: Endorsements) -> T:
        """Returns `read(key)` for the pinned key, or for the last key that it endorses.

        A successor is pinned from then on. Raises NotSigned if neither signed what is read.
        """
        if not self.keys:
            raise NotSigned("no key is pinned yet")
        try:
            return read(self.keys[-1])
        except NotSigned:
            successors = self.keys[-1].followed(endorsements())
            if not successors:
                raise
        result = read(successors[-1])
        self.keys += successors
        return result

    def see(self, note: str, prove: Proof, endorsements: Endorsements = list) -> Checkpoint:
        """Records a checkpoint that is signed and extends the last one, and returns it.

        An older one of the same log changes nothing, so that answers may overtake each other.
        Raises NotSigned, LogForked.
        """
        seen, last = self.believed(lambda key: Checkpoint.of(note, key), endorsements), self.last
        if last is not None:
            old, new = sorted((last, seen), key=lambda c: c.size)
            try:
                proof = prove(old.size, new.size) if 0 < old.size < new.size else []
            except Problem as error:
                if error.status != BAD_REQUEST:
                    raise  # the service cannot answer now
                raise LogForked(
                    f"a log of {new.size} entries was seen, and is not there any more "
                    f"({self._path})"
                ) from error
            if not extends(old.size, old.root, new.size, new.root, proof):
                raise LogForked(
                    f"a log of {new.size} entries does not extend the one of {old.size}; "
                    f"what was seen is in {self._path}"
                )
        if last is None or seen.size > last.size:
            self.last = seen
            self._keep()
        return seen

    def _keep(self) -> None:
        assert self.last is not None
        self._path.parent.mkdir(parents=True, exist_ok=True)
        partial = self._path.with_name(f"{self._path.name}.{uuid.uuid4().hex}")
        with partial.open("w") as file:
            *before, key = [key.text for key in self.keys]
            json.dump({"key": key, "before": before, "checkpoint": self.last.note}, file)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(self._path)
