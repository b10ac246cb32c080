"""One connection to the service: kept open, opened again when it broke.

A request is repeated only where repeating it is safe. A refusal is raised as its problem document.
"""

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

RETRY_PAUSES_S = (0.1, 0.2, 0.4)  # between attempts
REFUSED, UNAVAILABLE = 400, 503  # HTTP statuses: the lowest of a refusal, and "try again"
STREAM_BYTES = 1 << 20
CONNECT_LIMIT_S = 10.0


class Connection:
    """Sends requests to one address.

    `json`, `whole` and `tagged` repeat a request whose connection broke, so it must be safe to
    repeat: a read, a put by digest, or a post with an idempotency key. `once` and `parts` ask once.
    """

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
        """Sends a JSON document and returns the one answered. Raises Problem, Unreachable."""
        data = None if body is None else json.dumps(body).encode()
        content = self.whole(
            method, path, lambda: data, {"Content-Type": "application/json", **(headers or {})}
        )
        try:
            return json.loads(content)
        except ValueError as error:
            raise Unreachable(f"{self._url} answers, but not as trueup does") from error

    def whole(
        self, method: str, path: str, body: Any, headers: Mapping[str, str] | None = None
    ) -> bytes:
        """Sends what `body()` returns, again where the connection broke, and returns the answer.

        Raises Problem, Unreachable.
        """
        return self.tagged(method, path, body, headers or {})[2]

    def tagged(
        self, method: str, path: str, body: Any, headers: Mapping[str, str]
    ) -> tuple[int, http.client.HTTPMessage, bytes]:
        """Does what `whole` does, and returns the status, the headers and the content."""
        for pause_s in (*RETRY_PAUSES_S, None):
            try:
                response = self._request(method, path, body(), headers)
                content = response.read()
            except (http.client.HTTPException, OSError) as error:
                self._http.close()
                if pause_s is None or self.aborted:
                    raise Unreachable(f"{self._url} does not answer: {error}") from error
            else:
                if response.status < REFUSED:
                    return response.status, response.headers, content
                if response.status != UNAVAILABLE or pause_s is None:
                    raise Problem(response.status, _problem_document(content))
            time.sleep(pause_s)
        raise AssertionError

    def once(self, method: str, path: str, body: Any, headers: Mapping[str, str]) -> bytes:
        """Sends a request once and returns the whole answer.

        Raises Problem, and Unreachable if the connection breaks.
        """
        self._http.close()  # the service may have closed an idle one: sending must not discover it
        try:
            response = self._request(method, path, body, headers)
            content = response.read()
        except (http.client.HTTPException, OSError) as error:
            self._http.close()
            raise Unreachable(f"{self._url} broke off: {error}") from error
        if response.status >= REFUSED:
            raise Problem(response.status, _problem_document(content))
        return content

    def parts(self, path: str) -> Iterator[bytes]:
        """Yields an answer in parts. Raises Problem, and Unreachable if the connection breaks."""
        self._http.close()  # for the reason that `once` gives
        try:
            response = self._request("GET", path, None, {})
            if response.status >= REFUSED:
                raise Problem(response.status, _problem_document(response.read()))
            announced, read = response.headers.get("Content-Length"), 0
            while part := response.read(STREAM_BYTES):
                read += len(part)
                yield part
        except (http.client.HTTPException, OSError) as error:
            raise Unreachable(f"{self._url} broke off: {error}") from error
        finally:
            self._http.close()  # an answer not read to its end would be taken for the next one's
        if announced is not None and read != int(announced):
            raise Unreachable(f"{self._url} broke off after {read} of {announced} bytes")

    def _request(
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
        """Closes the connection."""
        self._http.close()

    def abort(self) -> None:
        """Closes the connection for good, from another thread.

        A request on its way ends with Unreachable.
        """
        self.aborted = True
        sock = self._http.sock
        if sock is not None:
            with contextlib.suppress(OSError):  # it ended by itself
                sock.shutdown(socket.SHUT_RDWR)


def _problem_document(body: bytes) -> dict[str, Any]:
    try:
        document = json.loads(body)
    except ValueError:
        document = None
    return (
        document if isinstance(document, dict) else {"detail": body[:200].decode(errors="replace")}
    )
