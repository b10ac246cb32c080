"""A client as a witness of the log: it keeps the last checkpoint that it saw, and refuses a log that does not extend it.

The file holds the log's public key, pinned at the first look unless it was given, and the checkpoint. Many witnesses who never talk to
each other still make it costly to show each of them another history: each refuses what does not extend its own.
"""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

from trueup_client.problem import NotSigned, Problem, Rewritten
from trueup_client.proof import Checkpoint, Key, extends

BAD_REQUEST = 400  # how a log answers that is shorter than it was
Proof: TypeAlias = "Callable[[int, int], Sequence[bytes]]"  # that a log of the second size extends one of the first


class Witness:
    """What was seen of one log, in a file.

    `key` is the log's public key as its operator gave it; without it, the first one seen is kept.
    """

    def __init__(self, path: str | os.PathLike[str], key: str | None = None) -> None:
        self._path = Path(path)
        found = json.loads(self._path.read_text()) if self._path.exists() else {}
        pinned = found.get("key")
        if key is not None and pinned is not None and key.strip() != pinned:
            raise NotSigned(f"{self._path} was pinned to another key")
        self._key_text: str | None = key.strip() if key else pinned
        self.key: Key | None = Key.from_text(self._key_text) if self._key_text else None
        self.last: Checkpoint | None = Checkpoint.of(found["checkpoint"], self.key) if self.key and "checkpoint" in found else None

    def pin(self, key: str) -> Key:
        """The key to believe: the one pinned, else this one from now on. Raises NotSigned where it is another."""
        offered = Key.from_text(key)
        if self.key is None:
            self.key, self._key_text = offered, key.strip()
        if offered != self.key:
            raise NotSigned(f"the log is signed by another key than the one pinned in {self._path}")
        return self.key

    def see(self, note: str, prove: Proof) -> Checkpoint:
        """Take a checkpoint, if it is signed and extends the last one. Raises NotSigned, Rewritten.

        An older one of the same log changes nothing, so that answers may overtake each other.
        """
        if self.key is None:
            raise NotSigned("no key is pinned yet")
        seen, last = Checkpoint.of(note, self.key), self.last
        if last is not None:
            old, new = sorted((last, seen), key=lambda c: c.size)
            try:
                proof = prove(old.size, new.size) if 0 < old.size < new.size else []
            except Problem as error:
                if error.status != BAD_REQUEST:
                    raise  # it cannot answer now
                raise Rewritten(f"a log of {new.size} entries was seen, and is not there any more ({self._path})") from error
            if not extends(old.size, old.root, new.size, new.root, proof):
                raise Rewritten(f"a log of {new.size} entries does not extend the one of {old.size}; what was seen is in {self._path}")
        if last is None or seen.size > last.size:
            self.last = seen
            self._keep()
        return seen

    def _keep(self) -> None:
        assert self.last is not None
        self._path.parent.mkdir(parents=True, exist_ok=True)
        beside = self._path.with_name(f"{self._path.name}.{uuid.uuid4().hex}")
        with beside.open("w") as file:
            json.dump({"key": self._key_text, "checkpoint": self.last.note}, file)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(self._path)
