"""The cycle: a machine wears, and its model is corrected without anybody watching, never without
evidence."""

import pytest

from tests.support.fleet import CUBIC, FRICTION, WORN, Fleet
from tests.support.service import command
from trueup.episode.role import Role
from trueup_client import Client, Problem

PROMISE_H, REFERENCE = 2.0, 20
# test_monitoring runs on both storages
pytestmark = pytest.mark.parametrize("service", ["scaled"], indirect=True, scope="module")


@pytest.fixture(scope="module")
def fleet(service, tmp_path_factory):
    client = Client(service.url, actor="fleet")
    found = Fleet(client, "wearing", tmp_path_factory.mktemp("fleet"), cubic=0.0)
    found.commission()
    yield found
    client.close()


def test_a_worn_machine_gets_its_model_corrected_by_itself_and_goes_on_being_watched(
    fleet, service
):
    client, name = fleet.client, fleet.name
    assert client.serving(name).version == 2
    fleet.watch(REFERENCE, PROMISE_H)
    fleet.automate(promise_h=PROMISE_H, reference_episodes=REFERENCE)
    fleet.visit(Role.ADAPTATION)
    fleet.until(lambda: client.monitor(name)["episodes"] == 2, "two healthy episodes are seen")
    assert list(client.alarms(name)) == []

    fleet.friction *= WORN
    fleet.visit(Role.ADAPTATION, Role.VALIDATION, Role.ADAPTATION, Role.VALIDATION)
    fleet.until(lambda: client.serving(name).generation == 3, "a correction is promoted")
    (alarm,) = client.alarms(name)
    assert alarm["closed_because"] == "promoted: version 3 serves from generation 3 on"
    decision = client.decision(name, client.serving(name).decision)
    assert [v["rule"] for v in decision["document"]["verdicts"]] == [
        "rollout_improves",
        "retained_conditions",
    ]
    assert [c["cell"] for c in decision["document"]["figures"]["cells"]] == [
        {"travel": "long"},
        {"travel": "short"},
    ]
    report = client.job(alarm["job"])["result"]["report"]
    level = next(
        e for e in report["effects"] if e["effect"] in ("coulomb_friction", "stribeck_friction")
    )["estimate"]["level"]
    assert level["value"] == pytest.approx(fleet.friction, rel=0.1)
    moved = next(
        e
        for e in client.audit(name)
        if e["kind"] == "pointer:moved" and e["facts"]["generation"] == 3
    )
    assert operations(client.audit(name)) == {
        "plant:registered": {None}, "job:submitted": {"monitoring", "model correction"},
        "alarm:raised": {"monitoring"},
        "decision:made": {"model correction"}, "pointer:moved": {"model correction"},
        "artifact:added": {"model correction"},
    }  # fmt: skip
    rehearsed = moved["facts"]["rehearsed"]
    assert rehearsed["loads"]
    assert rehearsed["seconds"] > 0.0
    assert rehearsed["rollout_error"]["forward"] < rehearsed["rollout_error"]["back"]

    assert "promote" in command(service, "policy", name).stdout
    assert not client.monitor(name)["watches"]
    for _ in range(REFERENCE // 2):
        fleet.visit(Role.REFERENCE)
    fleet.until(lambda: client.monitor(name)["watches"], "the new model is watched")
    before = client.monitor(name)["episodes"]
    fleet.visit(Role.ADAPTATION)
    fleet.until(lambda: client.monitor(name)["episodes"] >= before + 2, "it looks at what comes in")
    assert client.monitor(name)["alarm"] is None


def test_an_upload_says_where_it_goes_beyond_what_serves(fleet):
    far = fleet.record(Role.VALIDATION, "long", size=1.6)
    told = far["summary"]["collection"]
    assert told["outside"]["joint"]["hull"] > 0.05
    assert any("outside of what the serving model was fitted on" in w for w in told["warnings"])
    assert told["excitation"]["rank"] == 3


def test_what_forgets_a_covered_condition_is_rejected_and_the_decision_says_which(
    service, tmp_path
):
    client = Client(service.url, actor="fleet")
    fleet = Fleet(client, "forgetting", tmp_path)
    fleet.register()
    fleet.promote(fleet.add_candidate(FRICTION, CUBIC))
    fleet.friction *= WORN
    fleet.visit(Role.VALIDATION, Role.VALIDATION)
    decision = fleet.judge(fleet.add_candidate(fleet.friction, cubic=0.0))
    verdicts = {v["rule"]: v for v in decision["document"]["verdicts"]}
    assert not decision["accepted"]
    assert not verdicts["retained_conditions"]["passed"]
    assert verdicts["retained_conditions"]["because"] == "worse in: travel long"
    with pytest.raises(Problem) as refused:
        client.promote(fleet.name, decision["digest"], decision["generation"])
    assert refused.value.code == "decision-rejected"
    client.close()


def operations(entries):
    """Which of the four operations entries of each of these kinds were."""
    found = {}
    for entry in entries:
        found.setdefault(entry["kind"], set()).add(entry["facts"].get("operation"))
    kinds = (
        "plant:registered",
        "job:submitted",
        "alarm:raised",
        "decision:made",
        "pointer:moved",
        "artifact:added",
    )
    return {kind: found[kind] for kind in kinds}
