"""A gate cannot be shopped for in silence: every way to a rule that passes is refused, or told with
what was known, over REST."""

import http.client
import json
import os
import subprocess
import sys
import zlib
from contextlib import closing
from pathlib import Path

import pytest

from tests.support import forks
from tests.support.made import TRUE, episode_bytes, plant_document, save
from tests.support.service import Service, command
from tests.support.storage import embedded
from trueup.artifact.artifact import pack
from trueup.episode.role import Role
from trueup.episode.writer import Encoding
from trueup.gate.line import HELD_OUT_USES
from trueup.model.plant import Plant
from trueup.model.predictor import Identified
from trueup_client import Client, Problem

ROOT = Path(__file__).parents[2]
VERIFIER = ROOT / "tools" / "verify_archive.py"
SCORING = {"horizon_s": 0.5, "windows": "every"}
IMPROVES, ONE_STEP = (
    {"rule": "rollout_improves", "ratio": 0.98},
    {"rule": "one_step_no_worse", "slack": 0.1},
)
STRICT = {"schema": "trueup.gate/1", "rules": [IMPROVES, ONE_STEP], "scoring": SCORING}
B = (1.1, 0.5, 0.9)  # nearer to the machine than what was declared, and not by a factor of ten


class Bench:
    """A plant whose candidate B the strict gate has rejected, and who tries what follows: an
    engineer who may promote, and a colleague."""

    def __init__(self, admin: Client, url: str, name: str, folder) -> None:
        self.admin, self.url, self.name, self.folder = admin, url, name, folder
        self.me, self.colleague = (self.person(who) for who in ("shopper", "colleague"))
        self.me.register_plant(plant_document(name))
        # uses are counted over all plants: each has recordings of its own
        self.seed = zlib.crc32(name.encode()) % 300_000
        self.episodes = [self.held_out()]
        self.b = self.me.add_artifact(name, packed(name, B).manifest)["digest"]
        self.strict = self.me.declare_gate(name, STRICT)["digest"]
        self.rejected = self.judge(self.strict)
        assert not self.rejected["accepted"]

    def person(self, name: str) -> Client:
        return Client(
            self.url,
            token=self.admin.issue_token(name, ["engineer", "operator", "auditor"])["token"],
        )

    def held_out(self) -> str:
        self.seed += 1
        path = save(
            self.folder,
            f"{self.name}-{self.seed}.mcap",
            episode_bytes(self.seed, role=Role.VALIDATION, parameters=TRUE),
        )
        return self.me.upload_episode(self.name, path)["digest"]

    def judge(self, gate: str, candidate: str | None = None, episodes: list[str] | None = None):
        request = {
            "kind": "gate",
            "candidate": candidate or self.b,
            "gate": gate,
            "episodes": episodes or self.episodes,
        }
        return self.me.decision(
            self.name, self.me.wait(self.me.submit(self.name, request)["id"])["result"]["decision"]
        )

    def declare(self, **changed):
        return self.me.declare_gate(self.name, {**STRICT, **changed})

    def follow(self, because: str, **changed) -> str:
        return self.declare(
            follows=self.me.gate_in_force(self.name)["digest"], because=because, **changed
        )["digest"]

    def promote(self, decision, by: Client | None = None):
        return (by or self.me).promote(
            self.name, decision["digest"], self.me.serving(self.name).generation
        )


def packed(name: str, numbers):
    return pack(Identified(Plant.from_document(plant_document(name)), numbers), {"origin": "test"})


@pytest.fixture(scope="module")
def bench(service, tmp_path_factory):
    with closing(Client(service.url)) as admin:
        made = {}

        def of(name: str) -> Bench:
            if name not in made:
                made[name] = Bench(admin, service.url, name, tmp_path_factory.mktemp(name))
            return made[name]

        yield of
        for one in made.values():
            one.me.close()
            one.colleague.close()


def refused(act) -> Problem:
    with pytest.raises(Problem) as found:
        act()
    return found.value


def test_dropping_the_rule_that_failed_is_told_everywhere_and_promotes_nobody(bench, service):
    shop = bench("dropper")
    silent = refused(lambda: shop.declare(rules=[IMPROVES]))
    assert (silent.status, silent.code) == (409, "gate-follows")
    assert silent.facts["looser"] == ["it drops the rule one_step_no_worse"]
    assert silent.facts["in_force"] == shop.strict

    second = shop.follow("one step does not matter to us", rules=[IMPROVES])
    line = shop.me.gate_in_line(shop.name, second)
    assert (line["in_force"], line["follows"], line["looser"]) == (
        True,
        shop.strict,
        ["it drops the rule one_step_no_worse"],
    )
    accepted = shop.judge(second)
    assert accepted["accepted"]
    sentence = accepted["disclosure"]
    assert sentence == (
        f"This gate was declared after candidate {shop.b[:12]} had failed one_step_no_worse "
        f"on episode {shop.episodes[0][:12]} "
        f"by gate {shop.strict[:12]}. Over all plants, the most used of its held-out "
        "episodes had been used once before."
    )
    assert accepted["document"]["known"]["candidate"][0]["decision"] == shop.rejected["digest"]
    assert accepted["document"]["uses"] == [2]

    held = refused(lambda: shop.promote(accepted))
    assert (held.status, held.code) == (409, "rejected-before")
    assert held.facts["rejected_by"] == [shop.rejected["digest"]]

    replayed = command(service, "replay", accepted["digest"])
    assert sentence in replayed.stdout
    assert sentence in page(shop, f"/plants/{shop.name}/decisions/{accepted['digest']}")
    told = command(service, "audit", "verify", "--no-replay").stdout
    assert sentence in told
    assert "it drops the rule one_step_no_worse" in told
    archive = shop.folder / "p.tar"
    exported = forks.run(
        "trueup_cli.main",
        ["export", shop.name, str(archive)],
        {**os.environ, **service.storage.environment},
        ROOT,
    )
    assert exported.returncode == 0, exported.stderr
    offline = subprocess.run(
        [sys.executable, "-I", VERIFIER, archive, shop.me.audit_key()],
        capture_output=True,
        text=True,
        check=False,
    )
    assert offline.stdout == "holds\n"
    assert (
        f"gate {second[:12]} took the place of {shop.strict[:12]}: one step does not matter to us"
        in offline.stderr
    )
    assert f"judged: failed by gate {shop.strict[:12]}" in offline.stderr


def test_loosening_a_number_takes_a_fresh_test_to_promote(bench):
    shop = bench("loosener")
    loose = {"rule": "one_step_no_worse", "slack": 1.0}
    assert refused(lambda: shop.declare(rules=[IMPROVES, loose])).facts["looser"] == [
        "slack of one_step_no_worse is 1, was 0.1"
    ]
    second = shop.follow("0.1 was a slip of the pen", rules=[IMPROVES, loose])
    old = shop.judge(second)
    assert old["accepted"]
    assert refused(lambda: shop.promote(old)).code == "rejected-before"
    fresh = shop.held_out()
    mixed = shop.judge(second, episodes=[shop.episodes[0], fresh])
    assert refused(lambda: shop.promote(mixed)).facts["stale"] == [shop.episodes[0]]
    anew = shop.judge(second, episodes=[fresh])
    assert "had failed one_step_no_worse on other episodes" in anew["disclosure"]
    assert shop.promote(anew).generation == 2
    moved = next(e for e in shop.me.audit(shop.name) if e["kind"] == "pointer:moved")
    assert (moved["facts"]["rejected_before"], moved["facts"]["fresh_episodes"]) == (
        [shop.rejected["digest"]],
        True,
    )


def test_episodes_that_are_merely_others_are_no_fresh_test(bench):
    """Of many episodes that were there one may pass: what counts came in after the rejection."""
    shop = bench("picker")
    second = shop.follow("learned", rules=[IMPROVES, {"rule": "one_step_no_worse", "slack": 0.3}])
    others = [shop.held_out() for _ in range(2)]
    assert not shop.judge(second, episodes=[others[0]])["accepted"]
    second_try = shop.judge(shop.follow("once more", rules=[IMPROVES]), episodes=[others[1]])
    assert second_try["accepted"]
    assert refused(lambda: shop.promote(second_try)).facts["stale"] == [others[1]]


def test_declaring_the_rules_again_in_another_form_is_declaring_another_gate(bench):
    shop = bench("renamer")
    assert refused(lambda: shop.declare(conditions=["payload"])).code == "gate-follows"
    assert refused(lambda: shop.declare(rules=[ONE_STEP, IMPROVES])).code == "gate-follows"
    assert (
        refused(lambda: shop.declare(rules=[IMPROVES], follows="0" * 64, because="none")).code
        == "bad-gate"
    )
    assert shop.declare()["digest"] == shop.strict  # the very same is there already
    second = shop.follow("to tell payloads apart", conditions=["payload"])
    assert refused(lambda: shop.judge(shop.strict)).code == "gate-superseded"
    assert shop.judge(second)["accepted"] is False


def test_the_gate_of_another_plant_does_not_judge_here(bench):
    shop, other = bench("taker"), bench("lender")
    lent = other.follow("fewer rules", rules=[IMPROVES])
    assert refused(lambda: shop.judge(lent)).code == "not-found"
    taken = {
        k: v
        for k, v in other.me.gate(other.name, lent)["document"].items()
        if k not in ("follows", "because")
    }
    assert refused(lambda: shop.me.declare_gate(shop.name, taken)).code == "gate-follows"
    # with its reason, for it follows the same strict one
    shop.me.declare_gate(shop.name, other.me.gate(other.name, lent)["document"])
    assert (
        f"after candidate {shop.b[:12]} had failed one_step_no_worse"
        in shop.judge(lent)["disclosure"]
    )


def test_registering_the_plant_anew_is_known_by_its_episodes_and_by_the_models_errors(bench):
    shop = bench("founder")
    name = "founder-again"
    shop.me.register_plant(plant_document(name))
    for path in sorted(shop.folder.glob("*.mcap")):
        shop.me.upload_episode(name, path)
    b = shop.me.add_artifact(name, packed(name, B).manifest)["digest"]
    assert b != shop.b
    gate = shop.me.declare_gate(name, {**STRICT, "rules": [IMPROVES]})["digest"]
    request = {"kind": "gate", "candidate": b, "gate": gate}
    made = shop.me.decision(
        name, shop.me.wait(shop.me.submit(name, request)["id"])["result"]["decision"]
    )
    assert made["accepted"]
    assert made["document"]["uses"] == [2]
    assert made["document"]["known"]["episodes"] == [
        {
            "episode": shop.episodes[0],
            "plant": shop.name,
            "gate": shop.strict,
            "accepted": 0,
            "rejected": 1,
        }
    ]
    assert "also for plant founder" in made["disclosure"]
    held = refused(lambda: shop.me.promote(name, made["digest"], 1))
    assert (held.code, held.facts["rejected_by"]) == ("rejected-before", [shop.rejected["digest"]])


def test_it_takes_somebody_else_with_a_reason_and_two_tokens_are_not_two_people(bench, service):
    shop = bench("approver")
    accepted = shop.judge(shop.follow("one step does not matter", rules=[IMPROVES]))
    with closing(shop.person("Shopper ")) as again:
        again.approve(shop.name, accepted["digest"], "I am sure")
        assert refused(lambda: shop.promote(accepted)).code == "rejected-before"
    shop.colleague.approve(shop.name, accepted["digest"])
    assert refused(lambda: shop.promote(accepted)).code == "rejected-before"  # without a reason
    gone = shop.admin.issue_token("third", ["operator"])
    with closing(Client(shop.url, token=gone["token"])) as third:
        third.approve(shop.name, accepted["digest"], "on my way out")
    shop.admin.revoke_token(gone["prefix"])
    assert refused(lambda: shop.promote(accepted)).code == "rejected-before"
    with closing(shop.person("fourth")) as fourth:
        fourth.approve(shop.name, accepted["digest"], "the first step is within the sensor's noise")
        assert shop.promote(accepted).generation == 2
    moved = next(e for e in shop.me.audit(shop.name) if e["kind"] == "pointer:moved")
    assert moved["facts"]["approved_because"] == [
        {"actor": "fourth", "because": "the first step is within the sensor's noise"}
    ]
    assert (
        "with the approval of fourth and a reason"
        in command(service, "audit", "verify", "--no-replay").stdout
    )


def test_a_policy_whose_gate_was_superseded_says_so(bench):
    shop = bench("policyholder")
    shop.me.declare_policy(
        shop.name, {"schema": "trueup.policy/1", "gate": shop.strict, "on_diagnosis": "ask"}
    )
    told = "is no longer in force, so nothing is judged by itself"
    assert told not in page(shop, f"/plants/{shop.name}")
    shop.follow("one step does not matter", rules=[IMPROVES])
    assert told in page(shop, f"/plants/{shop.name}")


@pytest.mark.parametrize("reason", ["two\x1b[2Jlines", "title\x07", "back\x9b2J"])
def test_a_reason_that_would_command_a_terminal_is_refused(bench, reason):
    shop = bench(f"escape{ord(reason[3])}{len(reason)}")
    bad = refused(lambda: shop.follow(reason, rules=[IMPROVES]))
    assert (bad.code, bad.facts["field"]) == ("bad-gate", "because")
    accepted = shop.judge(shop.follow("one step does not matter", rules=[IMPROVES]))
    assert (
        refused(lambda: shop.colleague.approve(shop.name, accepted["digest"], reason)).status == 422
    )


def test_a_policy_may_forbid_it_outright(bench):
    shop = bench("forbidden")
    second = shop.follow("one step does not matter", rules=[IMPROVES])
    policy = {
        "schema": "trueup.policy/1",
        "gate": second,
        "on_rejected": "forbid",
        "on_diagnosis": "ask",
    }
    shop.me.declare_policy(shop.name, policy)
    accepted = shop.judge(second)
    shop.colleague.approve(shop.name, accepted["digest"], "fine by me")
    held = refused(lambda: shop.promote(accepted))
    assert held.code == "rejected-before"
    assert "forbids" in held.hint
    assert (
        refused(
            lambda: shop.me.declare_policy(shop.name, {**policy, "on_rejected": "approval"})
        ).code
        == "forbidden"
    )


def test_a_rule_that_nothing_can_fail_is_refused(bench):
    shop = bench("lax")
    for rules in (
        [{"rule": "rollout_improves", "ratio": 1e9}],
        [{"rule": "one_step_no_worse", "slack": 1.0}],
    ):
        held = refused(
            lambda rules=rules: shop.declare(rules=rules, follows=shop.strict, because="why not")
        )
        assert (held.status, held.code) == (422, "vacuous-gate")
    meant = shop.follow(
        "the first model of this machine is worse than none",
        rules=[{"rule": "one_step_no_worse", "slack": 1.0}],
        vacuous=True,
    )
    made = shop.judge(meant)
    assert made["document"]["figures"]["controls"]["incumbent"] == {"accepted": True, "failed": []}
    assert "it may accept the incumbent itself" in shop.me.gate_in_line(shop.name, meant)["looser"]


def test_uses_of_held_out_episodes_are_counted_from_the_first_and_end(bench):
    shop = bench("counter")
    for number in range(2, HELD_OUT_USES + 1):
        made = shop.judge(shop.strict)
        assert made["document"]["uses"] == [number]
    assert refused(lambda: shop.judge(shop.strict)).code == "held-out-spent"


def test_the_command_names_what_it_follows_and_shows_intervals_uses_and_scales(
    bench, service, tmp_path
):
    shop = bench("commander")
    rules = save(tmp_path, "gate.json", json.dumps({**STRICT, "rules": [IMPROVES]}).encode())
    done = command(service, "gate", shop.name, shop.b[:12], "--rules", str(rules), check=False)
    assert done.returncode == 1
    assert "gate-follows" in done.stderr
    done = command(
        service,
        "gate",
        shop.name,
        shop.b[:12],
        "--rules",
        str(rules),
        "--because",
        "learned",
        "--scales",
    )
    for said in (
        "accepted",
        "had failed one_step_no_worse",
        "Its reason: “learned”",
        "it drops the rule one_step_no_worse",
        "used 2 of 20",
    ):
        assert said in done.stdout
    assert "no scale moves the verdict" in done.stdout
    # in force: it needs no reason again
    again = command(service, "gate", shop.name, shop.b[:12], "--rules", str(rules))
    assert "used 3 of 20" in again.stdout
    assert len(list(shop.me.gates(shop.name))) == 2


def test_a_model_that_errs_alike_is_known_whatever_its_digest_its_episodes_and_the_horizon(
    bench, service
):
    """Nudged numbers make another artifact; on an episode and over a horizon that nobody has judged
    it by, it errs as B does."""
    shop = bench("nudger")
    other = shop.held_out()
    second = shop.follow(
        "a horizon of ours", rules=[IMPROVES], scoring={"horizon_s": 0.55, "windows": "every"}
    )
    nudged = shop.me.add_artifact(
        shop.name, packed(shop.name, tuple(x * (1 + 1e-5) for x in B)).manifest
    )["digest"]
    made = shop.judge(second, nudged, [other])
    assert made["accepted"]
    assert list(made["document"]["figures"]["beside"]) == [shop.b]
    near = (
        f"Its errors are within 1 % of those of candidate {shop.b[:12]}, which had been "
        "rejected or waited for its verdict."
    )
    assert near in made["disclosure"]
    assert "It was judged on 1 of the plant's 2 held-out episodes." in made["disclosure"]
    held = refused(lambda: shop.promote(made))
    assert (held.code, held.facts["rejected_by"]) == ("rejected-before", [shop.rejected["digest"]])
    replayed = command(service, "replay", made["digest"])
    assert "within 1 %" in replayed.stdout
    assert "within 1 %" in command(service, "audit", "verify", "--no-replay").stdout


def test_what_a_gate_was_chosen_among_is_told(bench):
    shop = bench("chooser")
    others = [shop.held_out() for _ in range(2)]
    far = shop.me.add_artifact(shop.name, packed(shop.name, (1.4, 0.5, 0.9)).manifest)["digest"]
    shop.me.wait(
        shop.me.submit(
            shop.name, {"kind": "compare", "first": shop.b, "second": far, "episodes": others}
        )["id"]
    )
    shop.judge(shop.strict, far, others[:1])
    made = shop.judge(shop.strict, shop.b, others[:1])
    assert made["document"]["selection"] == {
        "held_out": 3,
        "accepted": 0,
        "rejected": 1,
        "comparisons": 1,
    }
    said = (
        "Decisions on other candidates on these episodes since the gate was declared: "
        "accepted never, rejected once."
    )
    assert said in made["disclosure"]
    assert "Comparisons had shown errors on these episodes once." in made["disclosure"]


def test_another_gate_is_told_while_a_candidate_waits_for_its_verdict(tmp_path):
    waiting = Service(embedded(tmp_path))
    waiting.start_server()  # and no worker
    with closing(Client(waiting.url)) as client:
        client.register_plant(plant_document("queue"))
        episode = client.upload_episode(
            "queue",
            save(tmp_path, "e.mcap", episode_bytes(7, role=Role.VALIDATION, parameters=TRUE)),
        )
        strict = client.declare_gate("queue", STRICT)["digest"]
        b = client.add_artifact("queue", packed("queue", B).manifest)["digest"]
        client.submit(
            "queue",
            {"kind": "gate", "candidate": b, "gate": strict, "episodes": [episode["digest"]]},
        )
        held = refused(lambda: client.declare_gate("queue", {**STRICT, "rules": [IMPROVES]}))
        assert (held.code, held.facts["in_force"]) == ("gate-follows", strict)
    waiting.stop()


def test_another_project_is_no_other_world(bench):
    shop = bench("traveller")
    shop.admin.create_project("lab-z")
    name = "traveller-z"
    shop.admin.register_plant(plant_document(name), project="lab-z")
    path = next(shop.folder.glob("traveller-*.mcap"))
    shop.admin.upload_episode(name, path)
    b = shop.admin.add_artifact(name, packed(name, B).manifest)["digest"]
    gate = shop.admin.declare_gate(name, {**STRICT, "rules": [IMPROVES]})["digest"]
    job = shop.admin.wait(
        shop.admin.submit(name, {"kind": "gate", "candidate": b, "gate": gate})["id"]
    )
    made = shop.admin.decision(name, job["result"]["decision"])
    assert made["accepted"]
    assert "the most used of its held-out episodes had been used once before" in made["disclosure"]
    held = refused(lambda: shop.admin.promote(name, made["digest"], 1))
    assert (held.code, held.facts["rejected_by"]) == ("rejected-before", [shop.rejected["digest"]])


def test_the_same_samples_in_other_bytes_are_no_fresh_test(bench):
    shop = bench("copyist")
    second = shop.follow("one step does not matter", rules=[IMPROVES])
    again = episode_bytes(
        shop.seed, role=Role.VALIDATION, parameters=TRUE, encoding=Encoding.JSON, operator="ann"
    )
    copy = shop.me.upload_episode(shop.name, save(shop.folder, "copy.mcap", again))["digest"]
    assert copy != shop.episodes[0]
    made = shop.judge(second, episodes=[copy])
    assert made["document"]["uses"] == [2]
    held = refused(lambda: shop.promote(made))
    assert (held.code, held.facts["stale"]) == ("rejected-before", [copy])


def test_what_models_are_fitted_from_is_not_held_out_in_other_bytes(bench):
    shop = bench("relabeller")
    fitted = episode_bytes(shop.seed + 500, parameters=TRUE)
    shop.me.upload_episode(shop.name, save(shop.folder, "fitted.mcap", fitted))
    again = episode_bytes(shop.seed + 500, role=Role.VALIDATION, parameters=TRUE)
    held_out = shop.me.upload_episode(shop.name, save(shop.folder, "again.mcap", again))["digest"]
    assert refused(lambda: shop.judge(shop.strict, episodes=[held_out])).code == "role-refused"
    job = shop.me.submit(shop.name, {"kind": "gate", "candidate": shop.b, "gate": shop.strict})
    assert job["request"]["episodes"] == shop.episodes


def test_a_gate_that_followed_before_anything_was_judged_has_a_page(bench, service):
    shop = bench("early")
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document("earlier"))
        client.upload_episode("earlier", next(shop.folder.glob("*.mcap")))
        b = client.add_artifact("earlier", packed("earlier", B).manifest)["digest"]
        client.declare_gate("earlier", STRICT)
        second = client.declare_gate("earlier", {**STRICT, "rules": [IMPROVES]})["digest"]
        job = client.wait(
            client.submit("earlier", {"kind": "gate", "candidate": b, "gate": second})["id"]
        )
    assert "it drops the rule one_step_no_worse" in page(
        shop, f"/plants/earlier/decisions/{job['result']['decision']}"
    )


def test_what_is_looser_is_told_against_every_gate_before(bench):
    shop = bench("launderer")
    second = shop.follow("learned", rules=[IMPROVES])
    third = shop.follow("to be stricter", rules=[IMPROVES], held_out_uses=19)
    line = shop.me.gate_in_line(shop.name, third)
    assert line["looser"] == []
    assert line["looser_than"] == [
        {"gate": shop.strict, "looser": ["it drops the rule one_step_no_worse"]}
    ]
    made = shop.judge(third)
    assert f"looser than gate {shop.strict[:12]}: it drops the rule" in page(
        shop, f"/plants/{shop.name}/decisions/{made['digest']}"
    )
    assert second != third
    twice = refused(
        lambda: shop.follow(
            "both", rules=[IMPROVES, ONE_STEP, {"rule": "one_step_no_worse", "slack": 5.0}]
        )
    )
    assert (twice.code, twice.facts["rules"]) == ("bad-gate", ["one_step_no_worse"])


def test_a_vacuous_gate_is_told_with_every_decision(bench, service):
    shop = bench("hollow")
    reason = "the first model of this machine is worse than none"
    meant = shop.follow(reason, rules=[{"rule": "one_step_no_worse", "slack": 1.0}], vacuous=True)
    made = shop.judge(meant)
    assert "The gate accepts the incumbent itself" in made["disclosure"]
    assert reason in page(shop, f"/plants/{shop.name}/decisions/{made['digest']}")
    assert (
        "says of itself that it may accept the incumbent"
        in command(service, "audit", "verify", "--no-replay").stdout
    )


@pytest.mark.parametrize("nothing", ["\u200b", "\u2060 \u2060", "\u3164"])
def test_a_reason_of_which_nothing_is_seen_is_none(bench, nothing):
    shop = bench("mute")
    assert refused(lambda: shop.follow(nothing, rules=[IMPROVES])).code == "bad-gate"
    accepted = shop.judge(
        shop.follow("learned", rules=[IMPROVES], conditions=[f"c{ord(nothing[0])}"])
    )
    assert (
        refused(lambda: shop.colleague.approve(shop.name, accepted["digest"], nothing)).status
        == 400
    )


def page(shop: Bench, path: str) -> str:
    """A page's text as a browser gets it."""
    connection = http.client.HTTPConnection(shop.url.removeprefix("http://"))
    with closing(connection):
        connection.request(
            "GET",
            path,
            headers={
                "Authorization": f"Bearer {os.environ['TRUEUP_TOKEN']}",
                "Accept": "text/html",
            },
        )
        answer = connection.getresponse()
        assert answer.status == 200
        return answer.read().decode()
