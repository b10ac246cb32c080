"""One connection to the service: kept open, opened again when it broke, and repeated only where
repeating is safe."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import time
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import urlsplit

from trueup_client.problem import Problem, Unreachable

PAUSES_S = (0.1, 0.2, 0.4)  # between attempts
REFUSED, UNAVAILABLE = 400, 503
STREAM_BYTES = 1 << 20
CONNECT_LIMIT_S = 10.0


class Connection:
    """Sends requests. Every request here is safe to repeat: a read, a put by digest, or a post with
    an idempotency key."""

    def __init__(
        self, url: str, actor: str | None, timeout_s: float, token: str | None = None
    ) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise Unreachable(f"{url!r} is no http:// or https:// address")
        kind = (
            http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        )
        self._url, self._base = url, parts.path.rstrip("/")
        self.aborted = False
        self._timeout_s = timeout_s
        self._http = kind(parts.hostname, parts.port, timeout=min(timeout_s, CONNECT_LIMIT_S))
        self._headers = {"Trueup-Actor": actor} if actor else {}
        if token:
            self._headers["Authorization"] = f"Bearer {token}"

    def json(
        self, method: str, path: str, body: Any = None, headers: Mapping[str, str] | None = None
    ) -> Any:
        """Send a JSON document and read one. Raises Problem, Unreachable."""
        data = None if body is None else json.dumps(body).encode()
        found = self.whole(
            method, path, lambda: data, {"Content-Type": "application/json", **(headers or {})}
        )
        try:
            return json.loads(found)
        except ValueError as error:
            raise Unreachable(f"{self._url} answers, but not as trueup does") from error

    def whole(
        self, method: str, path: str, body: Any, headers: Mapping[str, str] | None = None
    ) -> bytes:
        """Send what `body()` gives and read the whole answer, again where the connection broke.
        Raises Problem, Unreachable."""
        return self.tagged(method, path, body, headers or {})[2]

    def tagged(
        self, method: str, path: str, body: Any, headers: Mapping[str, str]
    ) -> tuple[int, http.client.HTTPMessage, bytes]:
        """The same, with status and headers."""
        for pause_s in (*PAUSES_S, None):
            try:
                found = self._once(method, path, body(), headers)
                content = found.read()
            except (http.client.HTTPException, OSError) as error:
                self._http.close()
                if pause_s is None or self.aborted:
                    raise Unreachable(f"{self._url} does not answer: {error}") from error
            else:
                if found.status < REFUSED:
                    return found.status, found.headers, content
                if found.status != UNAVAILABLE or pause_s is None:
                    raise Problem(found.status, _document(content))
            time.sleep(pause_s)
        raise AssertionError

    def once(self, method: str, path: str, body: Any, headers: Mapping[str, str]) -> bytes:
        """Send once, and read the whole answer. Raises Problem, and Unreachable where it breaks
        off."""
        # the service may have closed a connection that nobody used: this must not be found out by
        # sending
        self._http.close()
        try:
            found = self._once(method, path, body, headers)
            content = found.read()
        except (http.client.HTTPException, OSError) as error:
            self._http.close()
            raise Unreachable(f"{self._url} broke off: {error}") from error
        if found.status >= REFUSED:
            raise Problem(found.status, _document(content))
        return content

    def parts(self, path: str) -> Iterator[bytes]:
        """Read an answer in parts. Raises Problem, and Unreachable where it breaks off."""
        self._http.close()  # as above
        try:
            found = self._once("GET", path, None, {})
            if found.status >= REFUSED:
                raise Problem(found.status, _document(found.read()))
            announced, read = found.headers.get("Content-Length"), 0
            while part := found.read(STREAM_BYTES):
                read += len(part)
                yield part
        except (http.client.HTTPException, OSError) as error:
            raise Unreachable(f"{self._url} broke off: {error}") from error
        finally:
            self._http.close()  # an answer not read to its end would be taken for the next one's
        if announced is not None and read != int(announced):
            raise Unreachable(f"{self._url} broke off after {read} of {announced} bytes")

    def _once(
        self, method: str, path: str, body: Any, headers: Mapping[str, str]
    ) -> http.client.HTTPResponse:
        try:
            self._connect()
            self._http.request(
                method, self._base + path, body=body, headers={**self._headers, **headers}
            )
        finally:
            if hasattr(body, "close"):
                body.close()
        return self._http.getresponse()

    def _connect(self) -> None:
        if self._http.sock is None and not self.aborted:
            self._http.connect()
        if self._http.sock is not None:
            self._http.sock.settimeout(self._timeout_s)
        if self.aborted:  # before, or while it was on its way
            self._http.close()
            raise http.client.NotConnected("the connection was closed")

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def abort(self) -> None:
        """Close it for good, from another thread: what is on its way ends with Unreachable."""
        self.aborted = True
        sock = self._http.sock
        if sock is not None:
            with contextlib.suppress(OSError):  # it ended by itself
                sock.shutdown(socket.SHUT_RDWR)


def _document(body: bytes) -> dict[str, Any]:
    try:
        found = json.loads(body)
    except ValueError:
        found = None
    return found if isinstance(found, dict) else {"detail": body[:200].decode(errors="replace")}
