"""Which names a request may call the service by.

A page of another site can give its own name the service's address (DNS rebinding): the browser then
takes the service for that site, and lets the page read what it answers. So the Host header must be
a name of the service's own.
- An address is nobody's name, and always allowed; so are `localhost` and what the machine calls
  itself.
- Other names are those of the settings: `host`, `public_url` and `allowed_hosts`, in which
  `*.example.com` stands for every name below example.com, and `*` for any name at all.
- Probes ask by whatever name: /healthz and /readyz tell nothing.
Source: RFC 9110, section 7.2 (Host) and 15.5.20 (421).
"""

from __future__ import annotations

import re
import socket
from urllib.parse import urlsplit

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from trueup_service.errors import UnknownHost
from trueup_service.host_names import is_address, is_listed, listed
from trueup_service.http import problems
from trueup_service.settings import Settings

ANY = "*"
# an address in brackets, or a name; a port
HOST = re.compile(r"(?:\[([0-9A-Fa-f:.]+)\]|([A-Za-z0-9._-]+?)\.?)(?::[0-9]*)?")
PROBES = ("/healthz", "/readyz")


class AllowedHosts:
    """ASGI middleware that responds 421 to requests for another host."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._allowed = allowed_hosts(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if (
            scope["type"] != "http"
            or scope["path"] in PROBES
            or self._is_allowed([v for k, v in scope["headers"] if k == b"host"])
        ):
            await self._app(scope, receive, send)
            return
        await problems.answer(Request(scope), UnknownHost())(scope, receive, send)

    def _is_allowed(self, hosts: list[bytes]) -> bool:
        return ANY in self._allowed or (
            len(hosts) == 1 and is_allowed(hosts[0].decode("latin-1"), self._allowed)
        )


def allowed_hosts(settings: Settings) -> frozenset[str]:
    """The allowed names of the settings and of this machine, in lower case."""
    public = urlsplit(settings.public_url).hostname if settings.public_url else None
    own = {"localhost", socket.gethostname().lower(), settings.host.lower()}
    return listed(settings.allowed_hosts) | own | ({public} if public else set())


def is_allowed(host: str, allowed: frozenset[str]) -> bool:
    """Whether a Host header is an address, one of these names, or a name below one of them that
    begins with `*.`."""
    match = HOST.fullmatch(host)
    name = (match[1] or match[2]).lower() if match else ""
    return is_listed(name, allowed) or is_address(name)
