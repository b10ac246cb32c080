"""The ways in which every call asks the service: a document, a list, a file, a change."""

from __future__ import annotations

import hashlib
import json
import os
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

from trueup_client.connection import Connection
from trueup_client.files import sync_folder
from trueup_client.problem import DigestMismatch, Unreachable
from trueup_client.records import Document

FIRST_RETRY_S, LONGEST_RETRY_S = 0.2, 5.0  # of a watch whose service is away
NOT_MODIFIED = 304


def url_path(*segments: object, **query: object) -> str:
    """Returns the path below /v1 of these segments, each quoted, and of the query without None."""
    path = "/v1/" + "/".join(quote(str(segment), safe="") for segment in segments)
    wanted = {name: value for name, value in query.items() if value is not None}
    return f"{path}?{urlencode(wanted)}" if wanted else path


class Transport:
    """Asks over one connection. The calls of each noun are written on top of it."""

    _connection: Connection

    def _get(self, path: str) -> Any:
        """Returns a document. Raises Problem, Unreachable."""
        return self._connection.json("GET", path)

    def _post(self, path: str, body: Document | None, key: str | None = None) -> Any:
        """Posts a document under an idempotency key, which makes repeating it safe."""
        headers = {"Idempotency-Key": key or uuid.uuid4().hex}
        return self._connection.json("POST", path, body, headers)

    def _text(self, path: str) -> str:
        """Returns an answer that is text."""
        return self._connection.whole("GET", path, lambda: None).decode()

    def _pages(self, path: str, cursor: str, **query: str | None) -> Iterator[Any]:
        """Yields the items of a list, page by page; `cursor` names the parameter that takes `next`.

        Raises DigestMismatch if a page leads back to one that was read.
        """
        wanted = {name: value for name, value in query.items() if value is not None}
        followed: set[str] = set()
        while True:
            page = self._get(f"{path}?{urlencode(wanted)}")
            yield from page["items"]
            if page["next"] is None:
                return
            wanted[cursor] = page["next"]
            if wanted[cursor] in followed:
                raise DigestMismatch(
                    f"the pages of {path} lead back to one that was read: a list has an end"
                )
            followed.add(wanted[cursor])

    def _changes(self, path: str, wait_s: float, confirmed: Callable[[], None]) -> Iterator[Any]:
        """Yields a document, then again whenever its ETag has changed, without end.

        Asks again while the service is away, after pauses that grow to LONGEST_RETRY_S [s]. Raises
        Problem for a refusal, and Unreachable once the connection was aborted.
        """
        tag, pause_s = "", FIRST_RETRY_S
        while True:
            try:
                status, headers, body = self._connection.tagged(
                    "GET",
                    f"{path}?wait_s={wait_s:g}",
                    lambda: None,
                    {"If-None-Match": tag} if tag else {},
                )
            except Unreachable:
                if self._connection.aborted:
                    raise
                time.sleep(pause_s)
                pause_s = min(2.0 * pause_s, LONGEST_RETRY_S)
                continue
            pause_s = FIRST_RETRY_S
            confirmed()
            if status != NOT_MODIFIED:
                tag = headers["ETag"]
                yield json.loads(body)

    def _save(self, path: str, digest: str, target: Path) -> None:
        """Saves an answer as a file, which gets its name only once its bytes are verified.

        Raises DigestMismatch if they are not what the digest names.
        """
        partial = target.with_name(f"{target.name}.{uuid.uuid4().hex}.part")
        sha256 = hashlib.sha256()
        try:
            with partial.open("wb") as file:
                for part in self._connection.parts(path):
                    sha256.update(part)
                    file.write(part)
                file.flush()
                os.fsync(file.fileno())
            if sha256.hexdigest() != digest:
                raise DigestMismatch(f"{path} gave {sha256.hexdigest()}")
            partial.replace(target)
            sync_folder(target.parent)
        finally:
            partial.unlink(missing_ok=True)
