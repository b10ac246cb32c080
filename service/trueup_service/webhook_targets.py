"""Where webhooks may send to.

Whoever declares a webhook makes the service send a request, from inside a network that the one who
declared it may not reach. So:
- a host must be allowed by the settings, by its name;
- the name is resolved when a request is sent, and the request goes to the address that was checked,
  so that a name that leads elsewhere a moment later (DNS rebinding) changes nothing;
- an address must be public, or in a range that the settings allow; an IPv4 address inside an IPv6
  one counts as itself;
- a public address is reached by https alone;
- redirects are not followed.
"""

from __future__ import annotations

import ipaddress
import socket
from dataclasses import dataclass
from urllib.parse import urlsplit

from trueup_service.control_characters import control_character
from trueup_service.errors import WebhookRefused
from trueup_service.host_names import is_listed, listed
from trueup_service.settings import Settings

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
Address = ipaddress.IPv4Address | ipaddress.IPv6Address
NAT64 = ipaddress.ip_network("64:ff9b::/96")  # RFC 6052, section 2.1
PORTS = {"http": 80, "https": 443}


@dataclass(frozen=True, slots=True)
class WebhookTargets:
    """The hosts and the private ranges that are allowed."""

    hosts: frozenset[str]
    private_ranges: tuple[Network, ...]

    @staticmethod
    def of(settings: Settings) -> WebhookTargets:
        """What the settings allow. Raises ValueError for a range that is none."""
        return WebhookTargets(
            listed(settings.webhook_hosts),
            tuple(ipaddress.ip_network(r) for r in sorted(listed(settings.webhook_private_ranges))),
        )

    def require_url(self, url: str) -> str:
        """The host of a URL that webhooks may send to. Raises WebhookRefused."""
        if not self.hosts:
            raise WebhookRefused("the service sends no webhooks")
        if control_character(url) or " " in url or not url.isascii():
            raise WebhookRefused("a URL has ASCII characters alone, and no blanks")
        try:
            parts = urlsplit(url)
            host, _ = (parts.hostname or "").lower(), parts.port
            host.encode("idna")  # which refuses labels that are empty or too long
        except ValueError as error:
            raise WebhookRefused(f"it is not a URL: {error}") from error
        if parts.scheme not in PORTS or not host:
            raise WebhookRefused("a webhook is sent to an https:// address")
        if "@" in parts.netloc or parts.fragment:
            raise WebhookRefused("the URL of a webhook has no user and no fragment")
        if not is_listed(host, self.hosts):
            raise WebhookRefused(f"webhooks may not be sent to {host!r}", host=host)
        if parts.scheme == "http" and not self.private_ranges:
            raise WebhookRefused("only private addresses are reached without TLS: use https://")
        return host

    def addresses(self, host: str, port: int, *, with_tls: bool) -> list[str]:
        """The addresses of a host that a request may go to. Raises WebhookRefused where it has
        none, and OSError where the name cannot be resolved."""
        entries = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        resolved = dict.fromkeys(str(entry[4][0]) for entry in entries)
        allowed = [a for a in resolved if self._is_allowed(a, with_tls=with_tls)]
        if not allowed:
            kind = "allowed" if with_tls else "private, which http:// takes,"
            raise WebhookRefused(f"no address of {host!r} is {kind}", host=host)
        return allowed

    def _is_allowed(self, address: str, *, with_tls: bool) -> bool:
        inner = _innermost(ipaddress.ip_address(address.partition("%")[0]))
        if any(inner in network for network in self.private_ranges):
            return True
        return with_tls and inner.is_global and not inner.is_multicast


def _innermost(address: Address) -> Address:
    """The IPv4 address that an IPv6 address stands for, else the address itself."""
    if isinstance(address, ipaddress.IPv4Address):
        return address
    inner = address.ipv4_mapped or address.sixtofour or (address.teredo or (None, None))[1]
    if address in NAT64:
        inner = ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
    return inner or address
