"""A client as a witness of the log: it keeps the last checkpoint that it saw, and refuses a log
that does not extend it.

The file holds the log's public key, pinned at the first look unless it was given, and the
checkpoint. Where the log has another key by now, the witness follows if the pinned one endorses it,
from each to the next. Many witnesses who never talk to each other still make it costly to show each
of them another history: each refuses what does not extend its own.
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
# the notes by which keys handed over, asked for where the pinned key did not sign
Endorsements: TypeAlias = "Callable[[], Iterable[str]]"
BAD_REQUEST = 400  # how a log answers that is shorter than it was
# that a log of the second size extends one of the first
Proof: TypeAlias = "Callable[[int, int], Sequence[bytes]]"


class Witness:
    """What was seen of one log, in a file.

    `key` is the log's public key as its operator gave it, and believed from then on; without it,
    the first one seen is kept.
    """

    def __init__(self, path: str | os.PathLike[str], key: str | None = None) -> None:
        self._path = Path(path)
        found = json.loads(self._path.read_text()) if self._path.exists() else {}
        self.keys = [
            Key.from_text(text) for text in (*found.get("before", []), found.get("key")) if text
        ]  # the one to believe last
        self.last: Checkpoint | None = (
            Checkpoint.of(found["checkpoint"], self.keys[-1]) if "checkpoint" in found else None
        )
        if key is not None and Key.from_text(key) not in self.keys:
            self.keys.append(Key.from_text(key))

    @property
    def key(self) -> Key | None:
        """The key to believe, None before one was pinned."""
        return self.keys[-1] if self.keys else None

    def pin(self, key: str) -> Key:
        """The key to believe: the one pinned, else this one from now on. Raises NotSigned where it
        is another."""
        offered = Key.from_text(key)
        self.keys = self.keys or [offered]
        if offered != self.keys[-1]:
            raise NotSigned(f"the log is signed by another key than the one pinned in {self._path}")
        return offered

    def believed(self, read: Callable[[Key], T], endorsements: Endorsements) -> T:
        """What a key to believe signed: the pinned one, else one that it endorses. Raises
        NotSigned."""
        if not self.keys:
            raise NotSigned("no key is pinned yet")
        try:
            return read(self.keys[-1])
        except NotSigned:
            then = self.keys[-1].followed(endorsements())
            if not then:
                raise
        found = read(then[-1])
        self.keys += then
        return found

    def see(self, note: str, prove: Proof, endorsements: Endorsements = list) -> Checkpoint:
        """Take a checkpoint, if it is signed and extends the last one. Raises NotSigned, LogForked.

        An older one of the same log changes nothing, so that answers may overtake each other.
        """
        seen, last = self.believed(lambda key: Checkpoint.of(note, key), endorsements), self.last
        if last is not None:
            old, new = sorted((last, seen), key=lambda c: c.size)
            try:
                proof = prove(old.size, new.size) if 0 < old.size < new.size else []
            except Problem as error:
                if error.status != BAD_REQUEST:
                    raise  # it cannot answer now
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
        beside = self._path.with_name(f"{self._path.name}.{uuid.uuid4().hex}")
        with beside.open("w") as file:
            *before, key = [key.text for key in self.keys]
            json.dump({"key": key, "before": before, "checkpoint": self.last.note}, file)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(self._path)
