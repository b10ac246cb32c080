"""Requests to webhooks: a signed POST of one event, to an address that was checked.

Source: Standard Webhooks 1.0, sections "Webhook headers" and "Signature scheme".
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import ssl
import threading
import time
from collections.abc import Iterable
from email.utils import parsedate_to_datetime
from types import TracebackType
from typing import Any

import httpcore2

from trueup import __version__
from trueup_service.control_characters import without_control_characters
from trueup_service.errors import WebhookRefused
from trueup_service.webhook_targets import WebhookTargets

DEADLINE_S = 10.0  # of a request: to connect, send, and receive the beginning of the answer
READ_BYTES = 4096  # of an answer; a longer one ends its connection
PROBLEM_BYTES = 200  # of an answer that are shown
ACCEPTED = range(200, 300)
GONE = 410  # that nobody listens there any more (RFC 9110, section 15.5.11)
PATIENCE = (429, 503)  # asked for by the receiver as a whole
REDIRECTS = range(300, 400)


class NotDelivered(Exception):
    """A request was not accepted: the `reason`, which names no text of the receiver's, and the
    `problem`, which may, and what it says of the next request.

    `is_of_receiver` where any other event would fare alike, and `gone` where it is for good.
    """

    def __init__(
        self,
        reason: str,
        words: str = "",
        *,
        is_of_receiver: bool = False,
        gone: bool = False,
        retry_after_s: float = 0.0,
    ) -> None:
        self.reason, self.problem = reason, f"{reason}: {words}" if words else reason
        super().__init__(self.problem)
        self.is_of_receiver, self.gone = is_of_receiver or gone, gone
        self.retry_after_s = retry_after_s


class WebhookRequests:
    """Connections to one webhook. They follow no redirects and use no proxy."""

    def __init__(
        self, targets: WebhookTargets, url: str, secret: str, tls: ssl.SSLContext | None = None
    ) -> None:
        self._url, self._secret, self._deadline = url, secret, _Deadline()
        self._pool = httpcore2.ConnectionPool(
            ssl_context=tls or httpcore2.default_ssl_context(),
            network_backend=_CheckedAddresses(
                targets, self._deadline, with_tls=url.startswith("https:")
            ),
        )

    def __enter__(self) -> WebhookRequests:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.close()

    def post(self, event_id: str, media_type: str, body: bytes) -> None:
        """Sends an event. Raises NotDelivered."""
        now_s = int(time.time())
        headers: dict[bytes | str, bytes | str] = {
            "content-type": media_type,
            "user-agent": f"trueup/{__version__}",
            "webhook-id": event_id,
            "webhook-timestamp": str(now_s),
            "webhook-signature": signature(self._secret, event_id, now_s, body),
        }
        self._deadline.set(DEADLINE_S)
        try:
            with self._pool.stream("POST", self._url, headers=headers, content=body) as response:
                status, answer = response.status, _beginning(response.iter_stream())
                retry_after_s = _retry_after_s(response.headers)
        except WebhookRefused as error:
            raise NotDelivered(error.message, is_of_receiver=True) from error
        except Exception as error:
            words = without_control_characters(str(error) or type(error).__name__)
            raise NotDelivered("it cannot be reached", words, is_of_receiver=True) from error
        if status not in ACCEPTED:
            redirect = "; redirects are not followed" if status in REDIRECTS else ""
            words = answer[:PROBLEM_BYTES].decode(errors="replace").strip()
            raise NotDelivered(
                f"it answered {status}{redirect}",
                without_control_characters(words),
                is_of_receiver=status in PATIENCE,
                gone=status == GONE,
                retry_after_s=retry_after_s,
            )


def signature(secret: str, event_id: str, now_s: int, body: bytes) -> str:
    """The value of `webhook-signature`: HMAC-SHA256 over id, time and body."""
    key = base64.b64decode(secret.partition("_")[2])
    signed = hmac.digest(key, f"{event_id}.{now_s}.".encode() + body, hashlib.sha256)
    return f"v1,{base64.b64encode(signed).decode()}"


class _Deadline(threading.local):
    """When the request of a thread must have ended."""

    _at = 0.0

    def set(self, seconds: float) -> None:
        self._at = time.monotonic() + seconds

    def left_s(self) -> float:
        """What is left [s]. Raises ReadTimeout."""
        left = self._at - time.monotonic()
        if left <= 0:
            raise httpcore2.ReadTimeout(f"it took longer than {DEADLINE_S:g} s")
        return left


class _CheckedAddresses(httpcore2.SyncBackend):
    """Connects to the addresses of a host that webhooks may reach, and to no other."""

    def __init__(self, targets: WebhookTargets, deadline: _Deadline, *, with_tls: bool) -> None:
        super().__init__()
        self._targets, self._deadline, self._with_tls = targets, deadline, with_tls

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore2.NetworkStream:
        failed: Exception | None = None
        for address in self._targets.addresses(host, port, with_tls=self._with_tls):
            try:
                stream = super().connect_tcp(
                    address, port, self._deadline.left_s(), local_address, socket_options
                )
            except (httpcore2.ConnectError, httpcore2.ConnectTimeout) as error:
                failed = error
            else:
                return _Timed(stream, self._deadline)
        assert failed is not None
        raise failed


class _Timed(httpcore2.NetworkStream):
    """A stream whose steps end at the deadline of the request."""

    def __init__(self, stream: httpcore2.NetworkStream, deadline: _Deadline) -> None:
        self._stream, self._deadline = stream, deadline

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self._stream.read(max_bytes, self._deadline.left_s())

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        self._stream.write(buffer, self._deadline.left_s())

    def close(self) -> None:
        self._stream.close()

    def start_tls(
        self,
        ssl_context: ssl.SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,
    ) -> httpcore2.NetworkStream:
        left_s = self._deadline.left_s()
        return _Timed(self._stream.start_tls(ssl_context, server_hostname, left_s), self._deadline)

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)


def _beginning(chunks: Iterable[bytes]) -> bytes:
    """The beginning of a body. The rest is read if it is short, so that its connection lives on."""
    body = b""
    for chunk in chunks:
        body += chunk
        if len(body) > READ_BYTES:
            break
    return body


def _retry_after_s(headers: Iterable[tuple[bytes, bytes]]) -> float:
    """The header Retry-After in seconds, 0 where there is none (RFC 9110, section 10.2.3)."""
    value = next((v.decode("latin-1") for k, v in headers if k.lower() == b"retry-after"), "")
    if value.isdecimal():
        return float(value[:9])
    try:
        return max(0.0, parsedate_to_datetime(value).timestamp() - time.time())
    except (TypeError, ValueError, OverflowError):
        return 0.0
