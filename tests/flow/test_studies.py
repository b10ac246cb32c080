"""Studies of a plant's versions in open and in closed loop: over REST, by the command and on a
folder they give one answer, and decisions disclose what a study has shown."""

import json

import pytest

from tests.conftest import EXAMPLE
from tests.support.case import write_case
from tests.support.service import command
from trueup.chapter.data import PLANT, draw
from trueup.chapter.published import PUBLISHED
from trueup_client import Client
from trueup_client.problem import Problem

SINE = ["--seed", "7", "--amplitude", "0.55", "--frequency-hz", "0.15", "--effort", "0.02"]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder, data = tmp_path_factory.mktemp("chapter"), draw()
    write_case(folder, PLANT, [data.adaptation, data.validation, data.test])
    return folder


@pytest.fixture(scope="module")
def identified(service, case):
    """The plant on the service, with an identified version."""
    command(service, "plant", "register", str(case))
    command(service, "upload", "chapter", str(case))
    fitted = json.loads(command(service, "fit", "chapter", "--json").stdout)
    return fitted["result"]["artifact"]


def study(service, name, target, folder, *options):
    out = folder / name
    command(service, name, str(target), "--out", str(out), *options)
    assert (out / "report.html").read_text().startswith("<!doctype html>")
    return json.loads((out / "report.json").read_text())


def by_regime(document):
    return {
        r["regime"]: {m["model"].split()[-1]: m["tracking"] for m in r["models"]}
        for r in document["regimes"]
    }


def test_the_service_runs_closed_loops_as_the_command_does_on_a_folder(
    service, case, identified, tmp_path
):
    options = ["--model", "1", "--model", identified[:12], "--sweep-ticks", "3", *SINE]
    ours = study(service, "closedloop", "chapter", tmp_path, *options)
    locally = study(service, "closedloop", case, tmp_path / "local", "--sweep-ticks", "3", *SINE)
    assert by_regime(ours) == by_regime(locally)
    assert ours["machine"]["model"] == "v2 identified"  # the newest identification stands in
    assert ours["artifacts"]["v2 identified"] == identified
    printed = PUBLISHED["Tracking error"]["deployment plant"]["nominal"]
    assert f"{by_regime(ours)['shifted']['nominal']:.5f}" == printed
    delayed = PUBLISHED["Tracking error"]["deployment + sensor delay of 3"]["nominal"]
    assert f"{ours['sweep'][0]['tracking']:.5f}" == delayed


def test_the_service_rolls_out_as_the_command_does_on_a_folder(service, case, identified, tmp_path):
    ours = study(service, "openloop", "chapter", tmp_path, "--model", "1", "--model", "2")
    locally = study(service, "openloop", case, tmp_path / "local")
    for here, there in zip(ours["models"], locally["models"], strict=True):
        assert here["errors"] == there["errors"]
    (episode,) = ours["episodes"]
    assert episode["role"] == "test"  # what no decision reads is rolled out by default
    assert ours["lipschitz"] == locally["lipschitz"]


def test_a_decision_discloses_that_an_open_loop_had_shown_its_episodes(service, identified):
    with Client(service.url) as client:
        (held_out,) = [e["digest"] for e in client.episodes("chapter") if e["role"] == "validation"]
        request = {"kind": "openloop", "versions": [identified], "episodes": [held_out]}
        shown = client.wait(client.submit("chapter", request)["id"])
        assert shown["reads"][held_out] == "compare"
        rules = json.loads((EXAMPLE / "gate.json").read_text())
        gate = client.declare_gate("chapter", rules)
        job = {"kind": "gate", "candidate": identified, "gate": gate["digest"]}
        decided = client.wait(client.submit("chapter", job)["id"])
        document = client.decision("chapter", decided["result"]["decision"])["document"]
    assert document["known"]["compared"] == [shown["id"]]
    command(service, "audit", "verify")


def test_what_cannot_be_studied_is_refused_with_what_to_do(service, identified):
    with Client(service.url) as client:
        for request, code in (
            ({"kind": "closedloop", "versions": ["0" * 64]}, "not-found"),
            ({"kind": "closedloop", "authority": 1.5}, "invalid-request"),
            ({"kind": "closedloop", "seeds": []}, "invalid-request"),
            ({"kind": "openloop", "horizons_steps": [0]}, "invalid-request"),
            ({"kind": "openloop", "machine": "f" * 64}, "not-found"),
        ):
            with pytest.raises(Problem) as refused:
                client.submit("chapter", request)
            assert refused.value.code == code, request
            assert refused.value.hint
