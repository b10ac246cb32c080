"""What others do appears on an open page without a reload, and takes nothing away from who is at
work on it."""

import json
import time
import urllib.request
from contextlib import closing

import pytest
from playwright.sync_api import expect

from tests.support.browser import Seat
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import ADMIN, Service
from tests.support.storage import embedded
from trueup_client import Client

PLANT = "bench-joint"
HOME = f"/plants/{PLANT}"
GRACE_S = 9.0  # a server waits ten for what is under way


@pytest.fixture(scope="module")
def running(scaled_service):
    with closing(Client(scaled_service.url, token=ADMIN)) as client:
        client.register_plant(plant_document(PLANT))
    return scaled_service


@pytest.fixture
def seat(browser, running, cookies):
    seat = Seat(browser, running, cookies=cookies)
    yield seat
    faults, _ = seat.faults, seat.context.close()
    assert faults == []


@pytest.fixture
def others(running):
    with closing(Client(running.url, token=ADMIN)) as client:
        yield client


def uploaded(client, folder, seed):
    path = save(folder, f"run-{seed}.mcap", episode_bytes(seed=seed))
    return client.upload_episode(PLANT, path)["digest"]


def opened(seat, path):
    """Goes to a page, and waits until it listens."""
    with seat.page.expect_response(lambda answer: "/live" in answer.url):
        seat.go(path)


def test_a_recording_that_somebody_uploads_appears_without_a_reload(seat, others, tmp_path):
    opened(seat, HOME)
    seat.page.evaluate("window.here = true")
    seat.page.locator("details > summary", has_text="entries as a list").click()
    digest = uploaded(others, tmp_path, 1)
    expect(seat.page.locator("#episodes ~ *", has_text=digest[:12]).first).to_be_attached()
    assert seat.page.evaluate("window.here") is True  # the page is the same
    section = seat.page.locator("details", has_text="entries as a list").first
    assert section.get_attribute("open") is not None


def test_who_types_is_told_and_keeps_what_was_typed(seat, others, tmp_path):
    opened(seat, HOME)
    field = seat.page.get_by_label("Features of the residual")
    field.fill("1,v,u")
    uploaded(others, tmp_path, 2)
    notice = seat.page.locator(".notice.live.entry")
    expect(notice).to_contain_text(f"A recording came in on {PLANT}.")
    assert field.input_value() == "1,v,u"
    field.fill("")
    notice.get_by_role("link", name="Show it").click()
    expect(seat.page.locator(".notice.live")).to_have_count(0)


def test_a_page_that_is_read_says_what_happened_and_stays(seat, others, tmp_path):
    first = uploaded(others, tmp_path, 3)
    opened(seat, f"{HOME}/episodes/{first}")
    uploaded(others, tmp_path, 4)
    expect(seat.page.locator(".notice.live.entry")).to_contain_text("A recording came in")


def test_what_happens_while_a_page_loads_is_shown(seat, others, tmp_path):
    digests = []

    def upload_first(route):
        digests.append(uploaded(others, tmp_path, 5))
        route.continue_()

    seat.page.route("**/live?*", upload_first, times=1)
    seat.go(HOME)
    seat.page.locator("details > summary", has_text="entries as a list").click()
    expect(seat.page.locator("#episodes ~ *", has_text=digests[0][:12]).first).to_be_attached()


def test_a_refusal_stays_until_it_is_read(seat, others, tmp_path):
    others.declare_channel(PLANT, "field", ["MIL"])
    opened(seat, f"{HOME}/channels")
    seat.page.get_by_label("Name").fill("field")
    seat.page.get_by_label("SIL", exact=True).check()
    with seat.page.expect_response(lambda answer: "/live" in answer.url):
        seat.page.get_by_role("button", name="Declare").click()
    refusal = seat.page.get_by_role("alert")
    expect(refusal).to_contain_text("field")
    uploaded(others, tmp_path, 6)
    notice = seat.page.locator(".notice.live.entry")
    expect(notice).to_contain_text("A recording came in")
    expect(refusal).to_be_visible()
    notice.get_by_role("link", name="Show it").click()
    seat.page.wait_for_url(f"**{HOME}")
    seat.faults[:] = [fault for fault in seat.faults if "409" not in fault]


def test_a_stream_that_is_refused_is_asked_for_again(seat, others, tmp_path):
    seat.page.route("**/live?*", lambda route: route.fulfill(status=503), times=1)
    opened(seat, HOME)
    digest = uploaded(others, tmp_path, 7)
    expect(seat.page.locator("#episodes ~ *", has_text=digest[:12]).first).to_be_attached()
    seat.faults[:] = [fault for fault in seat.faults if "503" not in fault]


def test_each_plant_has_its_own_alarm(seat):
    said = ""
    for i, plant in enumerate((PLANT, "other", PLANT), 9):
        alarm = {"plant": plant, "kind": "alarm:raised", "words": f"An alarm, the {i}th."}
        said += f"id: {i}\nevent: alarm\ndata: {json.dumps(alarm)}\n\n"
    headers = {"Content-Type": "text/event-stream"}
    seat.page.route("**/live?*", lambda route: route.fulfill(body=said, headers=headers))
    seat.go("/")
    alarms = seat.page.locator(".notice.live.alarm")
    expect(alarms).to_have_count(2)
    expect(alarms.first).to_contain_text("An alarm, the 11th.")


def test_an_alarm_leads_to_the_monitor_from_any_page(seat):
    alarm = {"plant": PLANT, "kind": "alarm:raised", "words": f"An alarm was raised on {PLANT}."}
    said = f"id: 9\nevent: alarm\ndata: {json.dumps(alarm)}\n\n"
    headers = {"Content-Type": "text/event-stream"}
    seat.page.route("**/live?*", lambda route: route.fulfill(body=said, headers=headers))
    seat.go(f"{HOME}/gate")
    notice = seat.page.get_by_role("alert").first
    expect(notice).to_contain_text(f"An alarm was raised on {PLANT}.")
    notice.get_by_role("link", name="Look").click()
    seat.page.wait_for_url(f"**{HOME}/monitor")


def test_a_page_that_nobody_looks_at_gives_its_stream_back(seat):
    opened(seat, HOME)
    hide = """hidden => {
      Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
      document.dispatchEvent(new Event("visibilitychange"));
    }"""
    with seat.page.expect_event("requestfailed", lambda r: "/live" in r.url):
        seat.page.evaluate(hide, True)
    with seat.page.expect_response(lambda answer: "/live" in answer.url) as again:
        seat.page.evaluate(hide, False)
    assert "after=" in again.value.url  # it hears what it missed


def stream_of(service, token=ADMIN, query="", timeout_s=60):
    """The stream of events, as a browser asks for it."""
    headers = {"Authorization": f"Bearer {token}"}
    asked = urllib.request.Request(f"{service.url}/live{query}", headers=headers)
    return urllib.request.urlopen(asked, timeout=timeout_s)


def events(service, token, query=""):
    with stream_of(service, token, query, timeout_s=10) as stream:
        kind = ""
        for line in stream:
            name, _, value = line.decode().strip().partition(": ")
            if name == "event":
                kind = value
            if name == "data":
                yield kind, json.loads(value)
                if kind == "at":
                    return


@pytest.fixture(scope="module")
def admin(service):
    """An admin of a service on either storage, which has the plant."""
    with closing(Client(service.url, token=ADMIN)) as client:
        client.register_plant(plant_document(PLANT))
        yield client


def test_a_stream_goes_on_with_what_happens(service, admin, tmp_path):
    with stream_of(service) as stream:
        lines = iter(stream.readline, b"")
        assert b"event: at\n" in lines  # it has begun
        uploaded(admin, tmp_path, 1)
        assert b"event: entry\n" in lines
        assert f"A recording came in on {PLANT}." in next(lines).decode()


def test_a_token_hears_of_its_own_plants_alone(service, admin):
    admin.create_project("elsewhere")
    token = admin.issue_token("reader", ["engineer"], project="elsewhere")["token"]
    heard = [data for kind, data in events(service, ADMIN, "?after=0") if kind == "entry"]
    assert f"A plant was registered on {PLANT}." in [e["words"] for e in heard]
    assert [data for kind, data in events(service, token, "?after=0") if kind == "entry"] == []


def test_what_happens_elsewhere_hides_nothing_of_a_plant(service, admin):
    for i in range(101):  # more than a stream tells at once
        admin.issue_token(f"reader-{i}", ["engineer"])
    heard = [data for kind, data in events(service, ADMIN, f"?after=0&plant={PLANT}")]
    assert heard[0]["words"] == f"A plant was registered on {PLANT}."


def test_a_server_that_is_told_to_stop_ends_its_streams(tmp_path):
    service = Service(embedded(tmp_path))
    with service.running(worker=False), stream_of(service) as stream:
        lines = iter(stream.readline, b"")
        assert next(lines) == b"retry: 3000\n"
        assert b"event: at\n" in lines  # it has begun
        began = time.monotonic()
        service.stop()
        assert time.monotonic() - began < GRACE_S
        assert stream.read().endswith(b"\n\n")
