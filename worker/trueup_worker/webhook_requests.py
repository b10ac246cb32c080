"""Requests to webhooks: a signed POST of one event, to an address that was checked.

Source: Standard Webhooks 1.0, sections "Webhook headers" and "Signature scheme".
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import ssl
import time
from collections.abc import Iterable
from email.utils import parsedate_to_datetime
from types import TracebackType
from typing import Any

import httpcore2

from trueup import __version__
from trueup_service.errors import WebhookRefused
from trueup_service.webhook_targets import WebhookTargets

TIMEOUT_S = 10.0  # of each step: connect, send, wait for the answer
READ_BYTES = 4096  # of an answer; a longer one ends its connection
PROBLEM_BYTES = 200  # of an answer that are shown
ACCEPTED = range(200, 300)
GONE = 410  # that nobody listens there any more (RFC 9110, section 15.5.11)
REDIRECTS = range(300, 400)
TOTAL_S = 30.0  # that an answer's body may take


class NotDelivered(Exception):
    """A request was not accepted: why, and what the receiver says of the next one.

    `unreachable` is of the receiver as a whole, `gone` for good.
    """

    def __init__(
        self,
        problem: str,
        *,
        unreachable: bool = False,
        gone: bool = False,
        retry_after_s: float = 0.0,
    ) -> None:
        super().__init__(problem)
        self.problem, self.unreachable, self.gone = problem, unreachable, gone
        self.retry_after_s = retry_after_s


class WebhookRequests:
    """Connections to one webhook. They follow no redirects and use no proxy."""

    def __init__(
        self, targets: WebhookTargets, url: str, secret: str, tls: ssl.SSLContext | None = None
    ) -> None:
        self._url, self._secret = url, secret
        self._pool = httpcore2.ConnectionPool(
            ssl_context=tls or httpcore2.default_ssl_context(),
            network_backend=_CheckedAddresses(targets, with_tls=url.startswith("https:")),
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
        limits = {"connect": TIMEOUT_S, "read": TIMEOUT_S, "write": TIMEOUT_S, "pool": None}
        try:
            with self._pool.stream(
                "POST", self._url, headers=headers, content=body, extensions={"timeout": limits}
            ) as response:
                status, answer = response.status, _beginning(response.iter_stream())
                retry_after_s = _retry_after_s(response.headers)
        except WebhookRefused as error:
            raise NotDelivered(error.message, unreachable=True) from error
        except (httpcore2.NetworkError, httpcore2.TimeoutException, OSError) as error:
            words = str(error) or type(error).__name__
            raise NotDelivered(f"it cannot be reached: {words}", unreachable=True) from error
        except (httpcore2.ProtocolError, httpcore2.UnsupportedProtocol) as error:
            raise NotDelivered(f"it does not answer in HTTP: {error}", unreachable=True) from error
        if status not in ACCEPTED:
            redirect = "; redirects are not followed" if status in REDIRECTS else ""
            words = answer[:PROBLEM_BYTES].decode(errors="replace").strip()
            raise NotDelivered(
                f"it answered {status}{redirect}" + (f": {words}" if words else ""),
                gone=status == GONE,
                retry_after_s=retry_after_s,
            )


def signature(secret: str, event_id: str, now_s: int, body: bytes) -> str:
    """The value of `webhook-signature`: HMAC-SHA256 over id, time and body."""
    key = base64.b64decode(secret.partition("_")[2])
    signed = hmac.digest(key, f"{event_id}.{now_s}.".encode() + body, hashlib.sha256)
    return f"v1,{base64.b64encode(signed).decode()}"


class _CheckedAddresses(httpcore2.SyncBackend):
    """Connects to the addresses of a host that webhooks may reach, and to no other."""

    def __init__(self, targets: WebhookTargets, *, with_tls: bool) -> None:
        super().__init__()
        self._targets, self._with_tls = targets, with_tls

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
                return super().connect_tcp(address, port, timeout, local_address, socket_options)
            except (httpcore2.ConnectError, httpcore2.ConnectTimeout) as error:
                failed = error
        assert failed is not None
        raise failed


def _beginning(chunks: Iterable[bytes]) -> bytes:
    """The beginning of a body. The rest is read if it is short, so that its connection lives on."""
    until, body = time.monotonic() + TOTAL_S, b""
    for chunk in chunks:
        body += chunk
        if len(body) > READ_BYTES or time.monotonic() > until:
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
