"""Drafts: plants that received files propose, until somebody registers them.

A draft is a folder on the disk of the server that received the files: the files, the episodes that
were made of them, and the draft as JSON. It is seen by the token alone that sent the files. It is
no record: a token has a number of drafts at once, of which the oldest goes first, and a draft that
nobody touches goes by its age. The files are with whoever sent them. One request at a time works on
a draft, and others are refused meanwhile.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import orjson

from trueup.canonical import Json
from trueup_service.errors import Conflict, NotFound

MOST = 8  # drafts of one token: as many logs as a person looks at side by side
NAME_CHARACTERS = 100
DOCUMENT, LOCK = "draft.json", ".lock"


@dataclass(frozen=True, slots=True)
class Draft:
    """A draft: its folder, and what it proposes."""

    folder: Path
    document: dict[str, Json]

    def episode(self, name: str) -> Path:
        """The path of an episode of the draft."""
        return self.folder / str(self.document["made"]) / name


class Drafts:
    """The drafts below a data folder."""

    def __init__(self, data_dir: Path) -> None:
        self._folder = data_dir / "drafts"

    @contextmanager
    def alone(self, token: str, digest: str) -> Iterator[None]:
        """A draft, while no other request works on it. Raises Conflict."""
        folder = self._of(token, digest)
        folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with folder.with_suffix(LOCK).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise Conflict(
                    "another request works on this draft",
                    hint="Wait until it has ended, and look at the page again.",
                ) from error
            yield

    def receive(self, token: str, digest: str, file: Path, name: str) -> Path:
        """Take a received file into the draft of its digest. Returns where it lies then."""
        self._make_room(token, digest)
        folder = self._of(token, digest) / "received"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(mode=0o700, parents=True)
        to = folder / file_name(name)
        os.replace(file, to)
        return to

    def received(self, token: str, digest: str) -> Path:
        """The received file of a draft. Raises NotFound."""
        folder = self._of(token, digest) / "received"
        # beside the file lies what an archive was unpacked to, where a process was killed
        files = [p for p in folder.iterdir() if p.is_file()] if folder.is_dir() else []
        if not files:
            raise _not_here(digest)
        return files[0]

    def holds(self, token: str, digest: str) -> bool:
        """Whether there is a draft, made whole."""
        return (self._of(token, digest) / DOCUMENT).is_file()

    def new_folder(self, token: str, digest: str) -> Path:
        """A folder of a draft, for the episodes that are made of its files."""
        return self._of(token, digest) / uuid.uuid4().hex

    def keep(self, token: str, digest: str, document: dict[str, Json], made: Path) -> Draft:
        """Keep what a draft proposes and the folder `made` of its episodes, in place of what it
        proposed before."""
        folder = self._of(token, digest)
        document = {**document, "digest": digest, "made": made.name}
        written = folder / f"{uuid.uuid4().hex}.json"
        written.write_bytes(orjson.dumps(document))
        os.replace(written, folder / DOCUMENT)
        for path in folder.iterdir():
            if path.is_dir() and path.name not in ("received", made.name):
                shutil.rmtree(path, ignore_errors=True)
        return self.get(token, digest)

    def get(self, token: str, digest: str) -> Draft:
        """A draft of a token. Raises NotFound."""
        folder = self._of(token, digest)
        try:
            document = orjson.loads((folder / DOCUMENT).read_bytes())
        except FileNotFoundError as error:
            raise _not_here(digest) from error
        os.utime(folder)  # which its age counts from
        return Draft(folder, document)

    def drop(self, token: str, digest: str) -> None:
        """Delete a draft."""
        shutil.rmtree(self._of(token, digest), ignore_errors=True)

    def remove_old(self, older_than_s: float) -> None:
        """Delete drafts that nobody touched for so long [s]."""
        for folder in self._folder.glob("*/*"):
            if folder.is_dir() and time.time() - _touched(folder) > older_than_s:
                self._remove(folder)

    def _of(self, token: str, digest: str) -> Path:
        return self._folder / hashlib.sha256(token.encode()).hexdigest() / digest

    def _make_room(self, token: str, digest: str) -> None:
        folders = self._of(token, digest).parent.glob("*")
        others = [f for f in sorted(folders, key=_touched) if f.is_dir() and f.name != digest]
        for folder in others[: max(len(others) - MOST + 1, 0)]:
            self._remove(folder)

    def _remove(self, folder: Path) -> None:
        """Delete the folder of a draft, unless a request works on it."""
        lock = folder.with_suffix(LOCK)
        with suppress(BlockingIOError), lock.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder, ignore_errors=True)
            lock.unlink(missing_ok=True)


def _not_here(digest: str) -> NotFound:
    return NotFound(
        "there is no such draft here",
        noun="draft",
        name=digest,
        hint="Send the files again, to this server.",
    )


def file_name(text: str) -> str:
    """A name of a file that is safe in a folder, made of any text; its end stays, for it says of
    which format the file is."""
    stem, dot, suffix = re.split(r"[/\\]", text)[-1].rpartition(".")
    stem, suffix = (_plain(part) for part in ((stem, suffix) if dot else (suffix, "")))
    return f"{stem or 'recording'}.{suffix}" if suffix else stem or "recording"


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).strip(".-")[-NAME_CHARACTERS // 2 :].strip(".-")


def _touched(folder: Path) -> float:
    try:
        return folder.stat().st_mtime
    except FileNotFoundError:
        return 0.0
