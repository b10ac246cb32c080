"""A monitor is calibrated, raises an alarm and has it closed, and studies are begun, by buttons."""

import re
from contextlib import closing

import pytest
from playwright.sync_api import expect

from tests.flow.test_monitoring import DOCUMENT, HEALTHY, upload
from tests.support.browser import A_MINUTE, Seat
from tests.support.service import ADMIN
from trueup.episode.role import Role
from trueup_client import Client

PLANT = DOCUMENT["name"]
HOME = f"/plants/{PLANT}"
DRIFTED = (Role.ADAPTATION, Role.ADAPTATION, Role.VALIDATION, Role.ADAPTATION)
expect.set_options(timeout=2 * A_MINUTE)


@pytest.fixture(scope="module")
def running(scaled_service):
    return scaled_service


@pytest.fixture(scope="module")
def client(running, tmp_path_factory):
    """A simulated joint, with its healthy operation."""
    folder = tmp_path_factory.mktemp("watched")
    with closing(Client(running.url, token=ADMIN)) as client:
        client.register_plant(DOCUMENT)
        for seed in range(HEALTHY):
            upload(client, folder, seed, Role.REFERENCE)
        for seed, role in ((50, Role.ADAPTATION), (51, Role.VALIDATION)):
            upload(client, folder, seed, role)
        yield client


@pytest.fixture
def seat(browser, cookies, running, client):
    seat = Seat(browser, running, cookies=cookies)
    yield seat
    faults, _ = seat.faults, seat.context.close()
    assert faults == []


def test_a_monitor_is_calibrated_raises_an_alarm_and_it_is_closed(seat, client, tmp_path):
    seat.go(f"{HOME}/monitor")
    expect(seat.page.locator("main")).to_contain_text("Nothing is watched")
    seat.page.get_by_label("Hours in which one false alarm is allowed [h]").fill("1")
    seat.page.get_by_role("button", name="Calibrate").click()
    seat.page.wait_for_url(re.compile(f"{HOME}/"))
    (job,) = [j for j in client.jobs(PLANT) if j["kind"] == "calibrate"]
    client.wait(job["id"])
    seat.go(f"{HOME}/monitor")
    expect(seat.page.get_by_role("heading", name="Version 1 is watched")).to_be_visible()
    for i, role in enumerate(DRIFTED):  # the joint rubs
        upload(client, tmp_path, 200 + i, role, friction=0.08)
    alarm = seat.page.get_by_role("region", name="Alarms")
    expect(alarm.get_by_role("button", name="Close the alarm")).to_be_visible()
    alarm.get_by_label("Because").fill("the brake was mended")
    alarm.get_by_role("button", name="Close the alarm").click()
    expect(alarm).to_contain_text("the brake was mended")
    assert [a["closed_because"] for a in client.alarms(PLANT)] == ["the brake was mended"]


@pytest.mark.parametrize("study", ["Open loop", "Consistency study"])
def test_a_study_is_begun_by_a_button_and_read_on_its_page(seat, study):
    seat.go(HOME)
    seat.page.get_by_role("button", name=f"{study} now").click()
    seat.page.wait_for_url(re.compile(f"{HOME}/studies/"))
    expect(seat.page.get_by_role("link", name="as one file")).to_be_visible()
