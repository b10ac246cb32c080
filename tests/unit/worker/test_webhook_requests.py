"""Requests to webhooks go to addresses that are allowed, and nowhere else."""

import contextlib
import socket
import ssl
import threading
import time
from dataclasses import replace
from ipaddress import ip_network

import pytest

from tests.support.certificates import authority
from tests.support.receiver import receiving
from trueup_service.errors import WebhookRefused
from trueup_service.webhook_targets import WebhookTargets
from trueup_worker import webhook_requests as module
from trueup_worker.webhook_requests import NotDelivered, WebhookRequests

PUBLIC_ONLY = WebhookTargets(frozenset({"hooks.example.com", "localhost"}), ())
LOCAL = replace(PUBLIC_ONLY, private_ranges=(ip_network("127.0.0.0/8"),))
SECRET = "whsec_" + "c2VjcmV0" * 4


def resolving(monkeypatch, *addresses):
    monkeypatch.setattr(
        socket,
        "getaddrinfo",
        lambda host, port, **_: [(0, 0, 0, "", (address, port)) for address in addresses],
    )


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1", "10.1.2.3", "172.16.0.1", "192.168.1.1", "100.64.0.1", "169.254.169.254",
        "0.0.0.0", "224.0.0.1", "255.255.255.255", "198.18.0.1", "::1", "::", "fe80::1%eth0",
        "fc00::1", "ff0e::1", "::ffff:10.0.0.1", "::ffff:169.254.169.254", "64:ff9b::a00:1",
        "2002:a00:1::", "2002:7f00:1::1",
    ],
)  # fmt: skip
def test_an_address_that_is_not_public_is_refused(monkeypatch, address):
    resolving(monkeypatch, address)
    with pytest.raises(WebhookRefused):
        PUBLIC_ONLY.addresses("hooks.example.com", 443, with_tls=True)


@pytest.mark.parametrize("address", ["93.184.216.34", "2606:2800:220:1::1", "64:ff9b::5db8:d822"])
def test_a_public_address_takes_tls(monkeypatch, address):
    resolving(monkeypatch, address)
    assert PUBLIC_ONLY.addresses("hooks.example.com", 443, with_tls=True) == [address]
    with pytest.raises(WebhookRefused, match="which http:// takes"):
        PUBLIC_ONLY.addresses("hooks.example.com", 80, with_tls=False)


def test_of_several_addresses_those_that_are_refused_are_left_out(monkeypatch):
    resolving(monkeypatch, "10.0.0.1", "93.184.216.34")
    assert PUBLIC_ONLY.addresses("hooks.example.com", 443, with_tls=True) == ["93.184.216.34"]


def test_a_name_is_resolved_when_a_request_is_sent(monkeypatch):
    resolving(monkeypatch, "169.254.169.254")
    with (
        WebhookRequests(PUBLIC_ONLY, "https://hooks.example.com/", SECRET) as requests,
        pytest.raises(NotDelivered, match="no address of 'hooks") as error,
    ):
        requests.post("id", "application/json", b"{}")
    assert error.value.is_of_receiver


def test_a_certificate_must_be_of_the_host(tmp_path):
    certificate = authority(tmp_path, "localhost")
    server_side = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    server_side.load_cert_chain(certificate.chain, certificate.key)
    trusting = ssl.create_default_context(cafile=str(certificate.authority))
    with receiving(server_side) as receiver:
        url = f"https://localhost:{receiver.port}/"
        with WebhookRequests(LOCAL, url, SECRET, trusting) as requests:
            requests.post("id", "application/json", b"{}")
            requests.post("id", "application/json", b"{}")
        assert len(receiver.requests) == 2
        for refused, tls in ((url, None), (f"https://127.0.0.1:{receiver.port}/", trusting)):
            with (
                WebhookRequests(LOCAL, refused, SECRET, tls) as requests,
                pytest.raises(NotDelivered, match="certificate"),
            ):
                requests.post("id", "application/json", b"{}")
        assert len(receiver.requests) == 2


def test_nobody_listens(monkeypatch):
    with receiving() as receiver:
        url = receiver.url
    with WebhookRequests(LOCAL, url, SECRET) as requests, pytest.raises(NotDelivered) as error:
        requests.post("id", "application/json", b"{}")
    assert error.value.is_of_receiver


def test_a_receiver_that_does_not_answer_is_given_up(monkeypatch):
    monkeypatch.setattr(module, "DEADLINE_S", 0.3)
    with (
        socket.create_server(("127.0.0.1", 0)) as silent,
        WebhookRequests(LOCAL, f"http://127.0.0.1:{silent.getsockname()[1]}/", SECRET) as requests,
        pytest.raises(NotDelivered, match="cannot be reached") as error,
    ):
        requests.post("id", "application/json", b"{}")
    assert error.value.is_of_receiver


@pytest.mark.parametrize(
    ("header", "low", "high"),
    [("120", 120, 120), ("Wed, 21 Oct 2099 07:28:00 GMT", 10**9, 10**10), ("soon", 0, 0)],
)
def test_when_to_come_again_is_read(header, low, high):
    with receiving() as receiver:
        receiver.answer = lambda _: (429, {"Retry-After": header})
        with (
            WebhookRequests(LOCAL, receiver.url, SECRET) as requests,
            pytest.raises(NotDelivered, match="429") as error,
        ):
            requests.post("id", "application/json", b"{}")
    assert low <= error.value.retry_after_s <= high


@pytest.mark.parametrize("drips", [b"HTTP/1.1 200 OK\r\nx-slow: ", b"HTTP/1.1 200 OK\r\n\r\n"])
def test_a_receiver_that_drips_is_given_up_in_time(monkeypatch, drips):
    monkeypatch.setattr(module, "DEADLINE_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def drip():
            with contextlib.suppress(OSError), server.accept()[0] as connection:
                connection.recv(65536)
                connection.sendall(drips)
                while True:
                    connection.sendall(b"x")
                    time.sleep(0.05)

        threading.Thread(target=drip, daemon=True).start()
        url, began = f"http://127.0.0.1:{server.getsockname()[1]}/", time.monotonic()
        with (
            WebhookRequests(LOCAL, url, SECRET) as requests,
            pytest.raises(NotDelivered, match=r"longer than|timed out"),
        ):
            requests.post("id", "application/json", b"{}")
        assert time.monotonic() - began < 5


@pytest.mark.parametrize(
    "url",
    ["https://hooks.example.com/\u00fc", "https://a..example.com/", "https://hooks.example.com/\n"],
)
def test_a_url_that_no_request_can_have_is_refused_at_once(url):
    targets = WebhookTargets(frozenset({"*.example.com"}), ())
    with pytest.raises(WebhookRefused):
        targets.require_url(url)
