"""Drafts: plants that received files propose, until somebody registers them.

A draft is a folder on the disk of the server that received the files: the files, the episodes that
were made of them, and the draft as JSON. It is seen by the token alone that sent the files. It is
no record: a token has a number of drafts at once, of which the oldest goes first, and a draft that
nobody touches goes by its age. The files are with whoever sent them.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

import orjson

from trueup.canonical import Json
from trueup_service.errors import NotFound

MOST = 8  # drafts of one token: as many logs as a person looks at side by side
NAME_CHARACTERS = 100
DOCUMENT = "draft.json"


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
        try:
            return next((self._of(token, digest) / "received").iterdir())
        except (FileNotFoundError, StopIteration) as error:
            raise _not_here(digest) from error

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
            if time.time() - _touched(folder) > older_than_s:
                shutil.rmtree(folder, ignore_errors=True)

    def _of(self, token: str, digest: str) -> Path:
        return self._folder / hashlib.sha256(token.encode()).hexdigest() / digest

    def _make_room(self, token: str, digest: str) -> None:
        folders = sorted(self._of(token, digest).parent.glob("*"), key=_touched)
        others = [folder for folder in folders if folder.name != digest]
        for folder in others[: max(len(others) - MOST + 1, 0)]:
            shutil.rmtree(folder, ignore_errors=True)


def _not_here(digest: str) -> NotFound:
    return NotFound(
        "there is no such draft here",
        noun="draft",
        name=digest,
        hint="Send the files again, to this server.",
    )


def file_name(text: str) -> str:
    """A name of a file that is safe in a folder, made of any text."""
    last = re.split(r"[/\\]", text)[-1]
    return re.sub(r"[^A-Za-z0-9._-]+", "-", last).strip(".-")[-NAME_CHARACTERS:] or "recording"


def _touched(folder: Path) -> float:
    try:
        return folder.stat().st_mtime
    except FileNotFoundError:
        return 0.0
