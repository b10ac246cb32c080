"""A page whose name leads to the service's address (DNS rebinding) is not answered: hosts are
checked against a list."""

import asyncio
import socket
import uuid

import pytest

from tests.http.test_http import problem, request
from tests.support.service import Service
from tests.support.storage import Storage, embedded
from trueup_service.http.hosts import AllowedHosts, allowed_hosts, is_allowed
from trueup_service.settings import Settings

FOREIGN = [
    "evil.example", "evil.example:8321", "localhost.evil.example", "127.0.0.1.evil.example",
    "evil.example#localhost",
    "", "[::1",
    "a@localhost", "localhost/x", "localhost:80:80", "..",
]  # fmt: skip
OWN = [
    "127.0.0.1",
    "127.0.0.1:8321",
    "localhost",
    "LOCALHOST:8321",
    "localhost.",
    "[::1]:8321",
    "192.168.1.7",
    "10.0.0.1:80",
]


@pytest.mark.parametrize("host", FOREIGN)
def test_another_host_is_refused_for_whatever_is_asked(service, host):
    for method, path in (
        ("GET", "/v1/plants"),
        ("POST", "/v1/plants"),
        ("GET", "/"),
        ("GET", "/openapi.json"),
        ("GET", f"/{uuid.uuid4().hex}"),
    ):
        assert problem(service, method, path, Host=host)[:2] == (421, "unknown-host")


@pytest.mark.parametrize("host", OWN)
def test_an_address_and_localhost_are_known(service, host):
    assert request(service, "GET", "/v1/plants", Host=host)[0] == 200


def test_probes_answer_by_any_name(service):
    for path in ("/healthz", "/readyz"):
        assert request(service, "GET", path, Host="10-0-0-7.pod.cluster")[0] == 200


def test_names_of_the_settings_are_known(tmp_path):
    storage = embedded(tmp_path / "data")
    more = {
        "TRUEUP_ALLOWED_HOSTS": "trueup, *.lab.example",
        "TRUEUP_PUBLIC_URL": "https://registry.example:8443/models",
    }
    with Service(Storage("named", storage.environment | more)).running(worker=False) as service:
        for host in ("trueup", "a.lab.example:80", "b.a.lab.example", "registry.example"):
            assert request(service, "GET", "/v1/plants", Host=host)[0] == 200
        for host in ("lab.example", "evillab.example", "trueup.example", "example"):
            assert problem(service, "GET", "/v1/plants", Host=host)[:2] == (421, "unknown-host")


def test_a_star_allows_any_name_and_the_name_to_listen_at_is_its_own():
    asked = []

    async def app(scope, _receive, _send):
        asked.append(dict(scope["headers"])[b"host"].decode())

    for host in FOREIGN:
        scope = {"type": "http", "path": "/v1/plants", "headers": [(b"host", host.encode())]}
        asyncio.run(AllowedHosts(app, Settings(allowed_hosts="*"))(scope, None, None))
    assert asked == FOREIGN
    assert is_allowed("robots.lab:8321", allowed_hosts(Settings(host="robots.lab")))
    assert is_allowed(socket.gethostname(), allowed_hosts(Settings()))
    assert not is_allowed("robots.lab:8321", allowed_hosts(Settings(host="0.0.0.0")))
