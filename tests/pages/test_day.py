"""A day's work in a browser, without a command line: a plant is registered from a person's own log,
diagnosed, judged, promoted, released and watched."""

import json
import re
import uuid

import pytest
from playwright.sync_api import expect

from tests.support.browser import A_MINUTE, Seat
from tests.support.case import write_friction_case
from tests.support.made import episode_bytes, identified, plant_document, save
from tests.support.service import ROOT, Service, command
from tests.support.storage import embedded
from trueup.diagnose.case import read_case
from trueup_client import Client, Problem

PENDULUM = ROOT / "tests" / "real" / "simple-pendulum"
MOST_CLICKS = 12
# of a dialog in which files are chosen: it is opened, files are marked, and it is closed
CLICKS_OF_A_DIALOG = 3
COUNT_CLICKS = """addEventListener('click', (event) => {
  if (event.isTrusted) sessionStorage.clicks = 1 + Number(sessionStorage.clicks || 0);
}, true)"""
expect.set_options(timeout=15000)


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with Service(embedded(tmp_path_factory.mktemp("day"))).running() as service:
        yield service


@pytest.fixture
def seat(browser, running, cookies):
    seat = Seat(browser, running, cookies=cookies)
    yield seat
    seat.context.close()
    assert seat.faults == []


@pytest.fixture
def client(running):
    with Client(running.url) as opened:
        yield opened


@pytest.fixture
def plant(client):
    name = f"p{uuid.uuid4().hex[:8]}"
    client.register_plant(plant_document(name))
    return name


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """The recordings of a real pendulum as a person would have them: one CSV file each."""
    folder = tmp_path_factory.mktemp("own") / "pendulum"
    folder.mkdir()
    _, episodes = read_case(PENDULUM)
    names = [c.name for c in (*episodes[0].layout.observations, *episodes[0].layout.commands)]
    for i, episode in enumerate(episodes):
        rows = ["time_s," + ",".join(names)]
        rows += [
            ",".join(map(repr, (float(t), *map(float, o), *map(float, u))))
            for t, o, u in zip(episode.t_s, episode.observations, episode.commands, strict=True)
        ]
        (folder / f"run-{i}.csv").write_text("\n".join(rows))
    return sorted(folder.iterdir())


# -- the main job


def test_from_ones_own_tables_to_a_promoted_correction_by_mouse_alone(seat, running, tables):
    page = seat.page
    seat.context.add_init_script(COUNT_CLICKS)
    seat.go("/")
    page.get_by_role("link", name="New plant…").click()
    with page.expect_file_chooser() as dialog:
        page.get_by_label("Files of the plant").click()
    dialog.value.set_files(tables)
    page.wait_for_url(re.compile("/new/[0-9a-f]{64}$"))
    expect(page.get_by_role("region", name="episodes", exact=True)).to_contain_text("validation")
    page.get_by_role("button", name="Register").click()
    page.wait_for_url(re.compile("/plants/"))
    page.get_by_role("button", name="Diagnose", exact=True).click()
    page.wait_for_url(re.compile("/diagnoses/"), timeout=3 * A_MINUTE)
    page.get_by_role("button", name="Judge", exact=True).click()
    page.wait_for_url(re.compile("/decisions/"), timeout=A_MINUTE)
    expect(page.locator("h1")).to_contain_text("Accepted")
    page.get_by_role("button", name="Promote version 2").click()
    page.wait_for_url(re.compile("/plants/run$"))
    expect(page.get_by_role("heading", name="Version 2 serves")).to_be_visible()
    clicks = int(page.evaluate("sessionStorage.clicks")) - 1 + CLICKS_OF_A_DIALOG
    assert clicks <= MOST_CLICKS
    with Client(running.url) as client:
        assert client.serving("run").version == 2


def test_a_dropped_log_is_corrected_and_looked_at_again(seat, tables):
    page = seat.page
    seat.go("/new")
    _drop(page, "odd.csv", "a,b,d,c\n" + "\n".join(tables[0].read_text().split("\n")[1:]))
    page.wait_for_url(re.compile("/new/[0-9a-f]{64}$"))
    expect(page.get_by_role("alert")).to_contain_text("Choose the signals below")
    for label, signal in (("position q", "b"), ("command u", "c"), ("time", "a")):
        page.get_by_role("combobox", name=label).select_option(signal)
    page.locator("[name=unit-q]").select_option("rad")
    page.locator("[name=time-unit]").select_option("s")
    page.get_by_role("button", name="Go on").click()
    expect(page.get_by_role("button", name="Register")).to_be_visible()
    expect(page.get_by_role("combobox", name="position q")).to_have_value("b")


def test_a_log_that_is_none_is_refused_with_what_to_do(seat):
    seat.go("/new")
    _drop(seat.page, "notes.txt", "hello")
    line = seat.page.locator(".sending.bad")
    expect(line).to_contain_text("rule columns")
    expect(line).to_contain_text("A table needs a column of time")
    seat.expect_refusal(422)


def _drop(page, name, content):
    """Drops a file on the page, as from a folder."""
    transfer = page.evaluate_handle(
        """([name, content]) => {
          const transfer = new DataTransfer();
          transfer.items.add(new File([content], name));
          return transfer;
        }""",
        [name, content],
    )
    page.dispatch_event("form.drop", "drop", {"dataTransfer": transfer})


# -- recordings


def test_several_recordings_are_uploaded_at_once_each_with_what_came_of_it(
    seat, plant, client, tmp_path
):
    good, silent = tmp_path / "good.mcap", tmp_path / "silent.csv"
    good.write_bytes(episode_bytes())
    silent.write_text("a,b,c\n" + "\n".join(f"{0.01 * i},{i % 7},{i % 3}" for i in range(99)))
    seat.go(f"/plants/{plant}/upload")
    seat.page.get_by_label("Recordings", exact=True).set_input_files([good, silent])
    lines = seat.page.locator(".sending")
    expect(lines.nth(0)).to_contain_text("uploaded: adaptation")
    expect(lines.nth(1)).to_contain_text("rule role")
    seat.page.get_by_label("What they are for").select_option("validation")
    lines.nth(1).get_by_role("button", name="Send it with the role above").click()
    expect(lines.nth(1)).to_contain_text("no column looks like the time")
    expect(lines.nth(1)).to_contain_text("field time")
    seat.expect_refusal(422)
    assert [e["role"] for e in client.episodes(plant)] == ["adaptation"]


# -- jobs


def test_what_waits_says_behind_what_and_is_cancelled(seat, plant, running, client, tmp_path):
    seat.go("/jobs")
    expect(seat.page.locator("#queue-now")).to_contain_text("Nothing is under way")
    running.stop(running.workers)
    for seed, role in ((1, "adaptation"), (2, "validation")):
        data = episode_bytes(seed=seed, role=role)
        client.upload_episode(plant, save(tmp_path, f"{seed}.mcap", data))
    for _ in range(2):
        client.submit(plant, {"kind": "fit", "method": "identify"})
    rows = seat.page.locator("#queue-now tbody tr")
    expect(rows).to_have_count(2)  # without reloading
    expect(rows.nth(1)).to_contain_text(f"Waits behind a fit of {plant}")
    rows.nth(1).get_by_role("button", name="Cancel").click()
    seat.page.wait_for_url(re.compile(f"/plants/{plant}/jobs"))
    expect(seat.page.get_by_text("cancelled")).to_be_visible()
    printed = command(running, "jobs", plant).stdout
    assert "cancelled" in printed
    assert "a worker takes it next" in printed
    waiting = next(j for j in client.jobs(plant) if j["state"] == "queued")
    command(running, "jobs", plant, "--cancel", waiting["id"][:8])
    running.start_worker()


def test_why_a_job_failed_is_on_its_page_and_in_the_command(seat, plant, running, client, tmp_path):
    client.upload_episode(plant, save(tmp_path, "e.mcap", episode_bytes()))
    slow = {"kind": "excite", "spread": 0.1, "duration_s": 2, "rate": 1e-9}
    job = client.submit(plant, slow)
    with pytest.raises(Problem, match=r"excitation|command"):
        client.wait(job["id"])
    seat.go(f"/plants/{plant}/jobs/{job['id']}")
    expect(seat.page.locator("h1")).to_contain_text("failed")
    shown = command(running, "jobs", plant, "--show", job["id"][:8]).stdout
    assert seat.page.locator(".notice.bad").inner_text() in shown


# -- an experiment


def test_an_experiment_is_designed_looked_at_and_downloaded(seat, plant, client, tmp_path):
    client.upload_episode(plant, save(tmp_path, "e.mcap", episode_bytes()))
    seat.go(f"/plants/{plant}")
    seat.page.get_by_role("link", name="Design an experiment…").click()
    expect(seat.page.get_by_label("Goal").locator("option").nth(1)).to_be_disabled()
    seat.page.get_by_label("From [Hz]").fill("0.5")
    seat.page.get_by_role("button", name="Design").click()
    expect(seat.page.get_by_role("alert")).to_contain_text("Fill in both frequencies")
    expect(seat.page.get_by_label("From [Hz]")).to_have_value("0.5")
    seat.expect_refusal(400)
    seat.page.get_by_label("To [Hz]").fill("3")
    seat.page.get_by_label("Duration [s]").fill("3")
    seat.page.get_by_label("Spread of the declared numbers [%]").fill("20")
    seat.page.get_by_role("button", name="Design").click()
    seat.page.wait_for_url(re.compile("/studies/"))
    check = seat.page.get_by_role("region", name="Check before you play it")
    expect(check).to_contain_text("emergency stop", timeout=3 * A_MINUTE)
    expect(seat.page.locator("h1")).to_contain_text("keeps its bounds under all 1000 models")
    with seat.page.expect_download() as download:
        seat.page.get_by_role("link", name="Download the command as CSV").click()
    table = download.value.path().read_text()
    assert table.startswith("# Bring the machine to rest at")
    (job,) = [j for j in client.jobs(plant) if j["kind"] == "excite"]
    assert (job["request"]["spread"], job["request"]["band_hz"]) == (0.2, [0.5, 3.0])


def test_a_feature_that_the_plant_does_not_have_is_refused_at_once(seat, plant, client, tmp_path):
    client.upload_episode(plant, save(tmp_path, "e.mcap", episode_bytes()))
    for feature in ("nonsense", "q7"):
        with pytest.raises(Problem, match=feature) as refused:
            client.submit(plant, {"kind": "fit", "method": "residual", "features": [feature]})
        assert refused.value.code == "bad-artifact"
    assert list(client.jobs(plant)) == []


# -- rules, policy, channels, monitor


def test_a_gate_is_declared_and_replaced_with_a_reason(seat, plant, client):
    seat.go(f"/plants/{plant}/gate")
    seat.page.get_by_role("button", name="Declare the default gate").click()
    expect(seat.page.get_by_role("heading", name="Next:")).to_be_visible()
    seat.go(f"/plants/{plant}/gate")
    rules = json.loads(seat.page.get_by_label("Rules, as JSON").input_value())
    rules["rules"][0]["ratio"] = 0.9
    seat.page.get_by_label("Rules, as JSON").fill("{not json")
    seat.page.get_by_role("button", name="Declare", exact=True).click()
    expect(seat.page.get_by_role("alert")).to_contain_text("not JSON")
    seat.page.get_by_label("Rules, as JSON").fill(json.dumps(rules))
    seat.page.get_by_label("Because").fill("the axis got slower")
    seat.page.get_by_role("button", name="Declare", exact=True).click()
    expect(seat.page.get_by_role("region", name="rules in force")).to_contain_text("0.9")
    assert client.gate_in_force(plant)["document"]["because"] == "the axis got slower"
    seat.expect_refusal(422)


def test_a_policy_is_declared(seat, plant, client):
    client.declare_gate(plant)
    seat.go(f"/plants/{plant}/policy")
    seat.page.get_by_label("on acceptance by the gate").select_option("promote")
    seat.page.get_by_label("people that a promotion takes").fill("2")
    seat.page.get_by_role("button", name="Declare").click()
    expect(seat.page.get_by_role("alert")).to_contain_text("on_acceptance must be `ask`")
    expect(seat.page.get_by_label("people that a promotion takes")).to_have_value("2")
    seat.page.get_by_label("on acceptance by the gate").select_option("ask")
    seat.page.get_by_role("button", name="Declare").click()
    expect(seat.page.locator("main")).to_contain_text("It is number 1")
    assert client.policy(plant)["document"]["approvals"] == 2
    seat.expect_refusal(422)


def test_a_version_is_released_to_a_channel_that_was_declared(seat, plant, client):
    seat.go(f"/plants/{plant}/channels")
    seat.page.get_by_label("Name").fill("field")
    seat.page.get_by_role("button", name="Declare").click()
    seat.page.get_by_role("button", name="Release to field").click()
    expect(seat.page.get_by_role("region", name="field")).to_contain_text("Serves version 1")
    assert client.channel_serving(plant, "field")["generation"] == 1
    seat.page.get_by_label("Name").fill("machines")
    seat.page.get_by_label("physical").check()
    seat.page.get_by_role("button", name="Declare").click()
    seat.page.get_by_role("button", name="Release to machines").click()
    expect(seat.page.get_by_role("alert")).to_contain_text("evidence")
    seat.expect_refusal(409)


def test_a_monitor_without_reference_says_what_it_needs(seat, plant):
    seat.go(f"/plants/{plant}/monitor")
    expect(seat.page.locator("main")).to_contain_text("There is no reference episode")
    seat.page.get_by_role("link", name="Upload", exact=True).click()
    expect(seat.page.locator("h1")).to_contain_text(f"Upload recordings of {plant}")


def test_a_promotion_by_two_is_approved_by_one_and_made_by_the_other(
    browser, running, seat, client, tmp_path
):
    plant = write_friction_case(tmp_path).name
    command(running, "plant", "register", str(tmp_path))
    command(running, "upload", plant, str(tmp_path))
    gate = client.declare_gate(plant)["digest"]
    client.declare_policy(
        plant, {"schema": "trueup.policy/1", "gate": gate, "on_acceptance": "ask", "approvals": 2}
    )
    seat.go(f"/plants/{plant}")
    seat.page.get_by_label("Fit a candidate").select_option("identify")
    seat.page.get_by_role("button", name="Fit", exact=True).click()
    seat.page.wait_for_url(re.compile("#versions"))
    seat.page.get_by_role("button", name="Judge version 2").click()
    seat.page.wait_for_url(re.compile("/decisions/"))
    seat.page.get_by_role("button", name="Promote version 2").click()
    expect(seat.page.get_by_role("alert")).to_contain_text("approv")
    seat.expect_refusal(409)
    digest = re.search("[0-9a-f]{64}", seat.page.url).group()
    other = Seat(browser, running)
    other.go("/sign-in")
    token = client.issue_token(f"other-{plant}", ["operator"])["token"]
    other.page.get_by_label("Token").fill(token)
    other.page.get_by_role("button", name="Sign in").click()
    other.page.wait_for_url(f"{running.url}/")
    other.go(f"/plants/{plant}/decisions/{digest}")
    other.page.get_by_label("Reason").fill("looked at the run on the bench")
    other.page.get_by_role("button", name="Approve", exact=True).click()
    expect(other.page.locator("main")).to_contain_text("Approvals so far: 1")
    other.context.close()
    seat.go(f"/plants/{plant}/decisions/{digest}")
    seat.page.get_by_role("button", name="Promote version 2").click()
    seat.page.wait_for_url(re.compile(f"/plants/{plant}$"))
    assert client.serving(plant).version == 2


def test_who_may_not_act_is_told_which_role_it_takes(browser, running, client, plant):
    reader = Seat(browser, running)
    reader.go("/sign-in")
    token = client.issue_token(f"reader-{plant}", ["auditor"])["token"]
    reader.page.get_by_label("Token").fill(token)
    reader.page.get_by_role("button", name="Sign in").click()
    reader.page.wait_for_url(f"{running.url}/")
    expect(reader.page.get_by_role("link", name="New plant…")).to_have_count(0)
    reader.go(f"/plants/{plant}")
    expect(reader.page.locator(".next")).to_contain_text("It takes the role engineer")
    reader.go("/new")
    expect(reader.page.locator("h1")).to_contain_text("engineer")
    reader.context.close()


def test_what_a_button_does_can_be_copied_as_a_command_and_as_rest(seat, plant, running):
    client_line = f"trueup fit {plant} --method identify"
    seat.context.grant_permissions(["clipboard-read", "clipboard-write"], origin=running.url)
    seat.go(f"/plants/{plant}")
    section = seat.page.get_by_role("region", name="Versions")
    section.get_by_text("Copy as a command or a REST call").click()
    section.locator(".copied").get_by_role("button", name="Copy").first.click()
    assert seat.page.evaluate("navigator.clipboard.readText()") == client_line
    expect(section).to_contain_text('"kind": "fit"')


def test_a_version_that_nobody_made_here_is_judged_from_its_line(seat, plant, client, tmp_path):
    for seed, role in ((3, "adaptation"), (4, "validation")):
        data = episode_bytes(seed=seed, role=role)
        client.upload_episode(plant, save(tmp_path, f"{seed}.mcap", data))
    client.declare_gate(plant)
    client.add_artifact(plant, identified(plant).manifest)
    seat.go(f"/plants/{plant}")
    seat.page.get_by_role("button", name="Judge version 2").click()
    seat.page.wait_for_url(re.compile("/decisions/"))
    expect(seat.page.locator("h1")).to_contain_text("version 2 against version 1")
