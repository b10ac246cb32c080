"""One connection to the service: kept open, opened again when it broke, and repeated only where repeating is safe."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from trueup_client.problem import Problem, Unreachable

ATTEMPTS = 4
FIRST_PAUSE_S = 0.1  # doubled at each attempt
STREAM_BYTES = 1 << 20


class Connection:
    """Sends requests. Every request here is safe to repeat: a read, a put by digest, or a post with an idempotency key."""

    def __init__(self, url: str, actor: str | None, timeout_s: float) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise Unreachable(f"{url!r} is no http:// or https:// address")
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        self._url, self._base = url, parts.path.rstrip("/")
        self._http = kind(parts.hostname, parts.port, timeout=timeout_s)
        self._headers = {"Trueup-Actor": actor} if actor else {}

    def json(self, method: str, path: str, body: Any = None, headers: Mapping[str, str] | None = None) -> Any:
        """Send a JSON document and read one. Raises Problem, Unreachable."""
        data = None if body is None else json.dumps(body).encode()
        given = {"Content-Type": "application/json", **(headers or {})}
        return json.loads(self.whole(method, path, lambda: data, given))

    def whole(self, method: str, path: str, body: Any, headers: Mapping[str, str] | None = None) -> bytes:
        """Send what `body()` gives and read the whole answer."""
        with self.answer(method, path, body, headers or {}) as found:
            return found.read()

    def parts(self, path: str) -> Iterator[bytes]:
        """Read an answer in parts."""
        with self.answer("GET", path, lambda: None, {}) as found:
            while part := found.read(STREAM_BYTES):
                yield part

    @contextmanager
    def answer(
        self, method: str, path: str, body: Any, headers: Mapping[str, str], allowed: Iterable[int] = ()
    ) -> Iterator[http.client.HTTPResponse]:
        """An open answer. Raises Problem for a refusal that is not in `allowed`."""
        found = self._send(method, path, body, headers)
        try:
            if found.status >= 400 and found.status not in allowed:  # noqa: PLR2004
                raise Problem(found.status, _document(found.read()))
            yield found
        finally:
            if not found.isclosed():
                self._http.close()  # an answer not read to its end would be taken for the next one's

    def _send(self, method: str, path: str, body: Any, headers: Mapping[str, str]) -> http.client.HTTPResponse:
        pause = FIRST_PAUSE_S
        for attempt in range(1, ATTEMPTS + 1):
            try:
                found = self._once(method, path, body(), headers)
                if found.status != 503 or attempt == ATTEMPTS:  # noqa: PLR2004
                    return found
                found.read()
            except (http.client.HTTPException, OSError) as error:
                self._http.close()
                if attempt == ATTEMPTS:
                    raise Unreachable(f"{self._url} does not answer: {error}") from error
            time.sleep(pause)
            pause *= 2
        raise AssertionError

    def _once(self, method: str, path: str, body: Any, headers: Mapping[str, str]) -> http.client.HTTPResponse:
        try:
            self._http.request(method, self._base + path, body=body, headers={**self._headers, **headers})
        finally:
            if hasattr(body, "close"):
                body.close()
        return self._http.getresponse()

    def close(self) -> None:
        """Close the connection."""
        self._http.close()


def _document(body: bytes) -> dict[str, Any]:
    try:
        found = json.loads(body)
    except ValueError:
        found = None
    return found if isinstance(found, dict) else {"detail": body[:200].decode(errors="replace")}
