"""Lists of what a plant has: names, tags and notes, sorted and filtered, each state of a list with
an address; and versions beside each other."""

import json
from contextlib import closing

import pytest
from playwright.sync_api import expect

from tests.conftest import EXAMPLE
from tests.support.browser import A_MINUTE, Seat
from tests.support.case import write_friction_case
from tests.support.service import ADMIN, command
from trueup_client import Client

PLANT = "simulated"
HOME = f"/plants/{PLANT}"


@pytest.fixture(scope="module")
def running(scaled_service):
    return scaled_service


@pytest.fixture(scope="module")
def judged(running, tmp_path_factory):
    """A plant with three versions, of which two were judged."""
    case = tmp_path_factory.mktemp("case")
    write_friction_case(case)
    command(running, "plant", "register", str(case))
    command(running, "upload", PLANT, str(case))
    for method in ("identify", "residual"):
        fit = command(running, "fit", PLANT, "--method", method, "--json").stdout
        artifact = json.loads(fit)["result"]["artifact"]
        rules = str(EXAMPLE / "gate.json")
        command(running, "gate", PLANT, artifact, "--rules", rules, check=False)
    with closing(Client(running.url, token=ADMIN)) as client:
        yield client


@pytest.fixture
def seat(browser, running, cookies, judged):
    seat = Seat(browser, running, cookies=cookies)
    yield seat
    faults, _ = seat.faults, seat.context.close()
    assert faults == []


def names(seat):
    return seat.page.locator("tbody tr td:first-child").all_inner_texts()


def labelled(seat, name, tags, note=""):
    """Fills the form of the page that is open, and saves it."""
    seat.page.locator("summary", has_text="name, tags and note").click()
    form = seat.page.locator(".labelling form")
    form.get_by_label("Name").fill(name)
    form.get_by_label("Tags, separated by commas").fill(tags)
    form.get_by_label("Note").fill(note)
    form.get_by_role("button", name="Save").click()
    expect(seat.page.get_by_role("heading", level=1)).to_be_visible()


def test_an_episode_is_named_and_found_by_its_tag(seat):
    seat.go(f"{HOME}/episodes")
    seat.page.locator("tbody a").first.click()
    labelled(seat, "after the repair", "Cold, rig 2", "Spring replaced.\nBelt was slack.")
    expect(seat.page.get_by_role("heading", level=1)).to_contain_text("after the repair")
    expect(seat.page.locator("p.note")).to_contain_text("Belt was slack.")
    seat.page.get_by_role("link", name="rig 2", exact=True).click()
    seat.page.wait_for_url(f"**{HOME}/episodes?tag=rig+2")
    assert names(seat) == ["after the repair"]
    seat.page.get_by_role("link", name="Show all").click()
    seat.page.get_by_label("Name or digest").fill("REPAIR")
    seat.page.get_by_role("button", name="Show", exact=True).click()
    assert names(seat) == ["after the repair"]
    seat.go(HOME)
    expect(seat.page.locator("#episodes ~ table", has_text="after the repair")).to_be_visible()


def test_a_list_is_sorted_by_a_click_and_its_address_says_how(seat, judged):
    seat.go(f"{HOME}/episodes")
    seat.page.get_by_role("link", name="duration").click()
    seat.page.wait_for_url("**sort=-duration")
    longest = names(seat)
    seat.page.get_by_role("link", name="duration ↓").click()
    seat.page.wait_for_url("**sort=duration")
    assert set(names(seat)) == set(longest)
    seat.page.locator("select[name=role]").select_option("validation")
    seat.page.get_by_role("button", name="Show", exact=True).click()
    address = seat.page.url
    shown = names(seat)
    assert len(shown) == sum(e["role"] == "validation" for e in judged.episodes(PLANT)) > 0
    seat.page.goto(address)
    assert names(seat) == shown
    assert seat.page.locator("select[name=role]").input_value() == "validation"


def test_versions_are_named_and_stand_beside_each_other(seat):
    seat.go(f"{HOME}/versions/2")
    labelled(seat, "refitted", "candidate")
    seat.go(f"{HOME}/versions")
    assert seat.page.get_by_role("cell", name="refitted").count() == 1
    for version in (1, 2, 3):
        seat.page.get_by_label(f"Compare version {version}").check()
    seat.page.get_by_role("button", name="Compare the chosen ones").click()
    expect(seat.page.get_by_role("heading", level=1)).to_have_text(
        "Versions 3, 2 and 1 beside each other"
    )
    head = seat.page.get_by_role("region", name="what differs").locator("thead th")
    assert head.count() == 4
    points = seat.page.locator("svg.curves a")
    assert points.count() == 4  # two decisions, each of a candidate and an incumbent
    seat.page.get_by_role("link", name="version 2 beside version 3").click()
    expect(seat.page.get_by_role("heading", level=1)).to_have_text("Version 2 beside version 3")


def test_decisions_are_listed_by_verdict(seat, judged):
    seat.go(f"{HOME}/decisions")
    seat.page.locator("select[name=verdict]").select_option("accepted")
    seat.page.get_by_role("button", name="Show", exact=True).click()
    accepted = sum(d["accepted"] for d in judged.decisions(PLANT))
    expect(seat.page.locator("tbody tr")).to_have_count(accepted)
    seat.page.locator("tbody a").first.click()
    labelled(seat, "the first good one", "kept")
    expect(seat.page.get_by_text("the first good one")).to_be_visible()


def test_a_rejected_candidate_says_why_and_is_judged_again_with_what_is_uploaded(
    seat, judged, running, tmp_path
):
    first = next(judged.decisions(PLANT))
    figure = first["document"]["verdicts"][0]
    rules = tmp_path / "gate.json"
    rules.write_text(
        json.dumps(
            {
                "schema": "trueup.gate/1",
                "rules": [{"rule": figure["rule"], "ratio": 0.9999 * figure["ratio"]}],
                "scoring": {"horizon_s": 1.0, "windows": "every"},
            }
        )
    )
    printed = command(
        running,
        *("gate", PLANT, first["candidate"], "--rules", str(rules)),
        *("--because", "a bound at the figure itself"),
        check=False,
    ).stdout
    assert f"{figure['rule']} refuses: the error is" in printed
    assert f"next: trueup upload {PLANT} FILES --role validation" in printed
    assert f"then: trueup gate {PLANT} {first['candidate'][:12]} --episode" in printed
    rejected = next(judged.decisions(PLANT))
    assert not rejected["accepted"]
    seat.go(f"{HOME}/decisions/{rejected['digest']}")
    why = seat.page.get_by_role("region", name="Why it was rejected")
    expect(why).to_contain_text("these recordings do not settle it")
    expect(why.get_by_role("button", name="Judge on what is new")).to_have_count(0)
    why.get_by_role("link", name="Upload recordings…").click()
    seat.page.wait_for_url(f"**{HOME}/upload")
    write_friction_case(tmp_path, seed=12)
    command(running, "upload", PLANT, str(next(tmp_path.glob("*-validation.mcap"))))
    seat.go(f"{HOME}/decisions/{rejected['digest']}")
    expect(why).to_contain_text("1 held-out recording was uploaded since: judge on it alone.")
    why.get_by_role("button", name="Judge on what is new").click()
    expect(seat.page.locator("h1")).to_contain_text("against version", timeout=A_MINUTE)
    episodes = next(judged.decisions(PLANT))["document"]["episodes"]
    assert len(episodes) == 1
    assert episodes[0] not in rejected["document"]["episodes"]


def test_plants_are_found_by_name_and_tag_and_a_hostile_one_stays_text(seat, judged):
    seat.go(HOME)
    labelled(seat, "<b>Left</b> bench", "<i>site</i> 4")
    seat.go("/?q=left")
    expect(seat.page.get_by_text("<b>Left</b> bench")).to_be_visible()
    seat.page.get_by_role("link", name="<i>site</i> 4").click()
    expect(seat.page.locator("tbody tr")).to_have_count(1)
    seat.go("/?tag=nowhere")
    expect(seat.page.get_by_text("No plant matches with the tag “nowhere”")).to_be_visible()
    seat.go("/?alarm=open")
    expect(seat.page.get_by_text("has an open alarm")).to_be_visible()


@pytest.mark.parametrize(
    "path",
    ["episodes?sort=nonsense&page=99&role=x", "versions?tag=%22%25", "decisions?q=%25_%5C"],
)
def test_odd_addresses_are_lists_all_the_same(seat, path):
    seat.go(f"{HOME}/{path}")
    expect(seat.page.get_by_role("heading", level=1)).to_contain_text(PLANT)


def test_the_timeline_goes_closer_and_back_to_the_newest(seat):
    seat.go(HOME)
    seat.page.locator("summary", has_text="entries as a list").wait_for()
    seat.page.get_by_role("group", name="stretch of time").get_by_role(
        "link", name="Closer"
    ).click()
    seat.page.wait_for_url("**since=**")
    expect(seat.page.locator("#entries")).to_have_attribute("open", "")
    seat.page.get_by_role("link", name="Newest").click()
    seat.page.wait_for_url(f"**{HOME}#when")
    for odd in ("nonsense&until=2", "0001-01-05&until=2026-01-01", "2026-01-01&until=9999-12-31"):
        seat.go(f"{HOME}?since={odd}")
        expect(seat.page.get_by_role("heading", level=1)).to_be_visible()
    seat.go(HOME)
    expect(seat.page.locator("svg.timeline a").first).to_be_attached()


def test_more_than_six_versions_are_refused_with_what_to_do(seat):
    seat.go(f"{HOME}/compare?" + "&".join(f"v={n}" for n in range(1, 8)))
    expect(seat.page.get_by_text("Choose two to 6 of them.")).to_be_visible()
    seat.faults[:] = [fault for fault in seat.faults if "400" not in fault]


def test_what_somebody_else_saved_meanwhile_is_not_overwritten_and_nothing_written_is_lost(
    seat, judged
):
    version = next(v for v in judged.artifacts(PLANT) if v["version"] == 3)["digest"]
    seat.go(f"{HOME}/versions/3")
    judged.change_label(PLANT, "version", version, name="theirs", note="Checked on the rig.")
    labelled(seat, "mine", "checked", "Looks odd at low speed.")
    alert = seat.page.get_by_role("alert")
    expect(alert).to_contain_text("Nothing was changed")
    seat.expect_refusal(409)
    expect(seat.page.get_by_text("Checked on the rig.")).to_be_visible()
    assert judged.label(PLANT, "version", version)["name"] == "theirs"
    expect(seat.page.get_by_label("Note")).to_have_value("Looks odd at low speed.")
    seat.page.get_by_role("button", name="Save").click()
    seat.page.wait_for_url(f"**{HOME}/versions/3")
    label = judged.label(PLANT, "version", version)
    assert (label["name"], label["note"]) == ("mine", "Looks odd at low speed.")


def test_a_tag_that_cannot_be_used_is_refused_on_a_page_that_keeps_the_note(seat):
    seat.go(HOME)
    labelled(seat, "bench", "x" * 41, "A long note.")
    expect(seat.page.get_by_role("alert")).to_contain_text("at most 20 tags")
    seat.expect_refusal(400)
    expect(seat.page.get_by_label("Note")).to_have_value("A long note.")


def test_a_page_behind_the_end_of_a_list_leads_to_its_last(seat):
    seat.go(f"{HOME}/versions?sort=version&page=99")
    seat.page.wait_for_url(f"**{HOME}/versions?sort=version")
    assert len(names(seat)) == 3


def test_plants_are_filtered_as_one_chooses_and_the_address_follows(seat, judged):
    judged.change_label(PLANT, "plant", PLANT, tags=["hall 3"])
    seat.go("/")
    seat.page.get_by_label("Tag").press_sequentially("hall 3")
    seat.page.wait_for_url("**tag=hall+3**")
    expect(seat.page.locator("#plants tbody tr")).to_have_count(1)
    seat.page.get_by_label("Alarm").select_option("open")
    seat.page.wait_for_url("**alarm=open**")
    expect(seat.page.get_by_text("has an open alarm")).to_be_visible()
    seat.page.reload()
    expect(seat.page.get_by_label("Tag")).to_have_value("hall 3")
    expect(seat.page.get_by_label("Alarm")).to_have_value("open")
