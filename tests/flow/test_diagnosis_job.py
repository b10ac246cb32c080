"""A diagnosis as a job of the service gives the command's report, and its model is a candidate like
any other; so does a blind trial.

On embedded storage `test_docs` runs `docs/tutorial.md`, which takes a diagnosis to a promotion.
"""

import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest

from tests.flow.test_failures import until
from tests.support.case import write_case
from tests.support.service import command
from tests.support.simulated import recorded_twice as recorded
from trueup.blindtrial.commitment import require_commitments
from trueup_client import Client


@pytest.fixture(scope="module")
def service(scaled_service):
    return scaled_service


@pytest.fixture(scope="module")
def done(service, tmp_path_factory):
    folder = tmp_path_factory.mktemp("job")
    # its model has arrays: moments of a known velocity
    plant, episodes, _ = recorded("A1", ["quadratic_drag"], 21, velocity=False)
    write_case(folder, plant, episodes)
    command(service, "plant", "register", str(folder))
    command(service, "upload", "simulated", str(folder))
    job = json.loads(command(service, "diagnosis", "simulated", "--json").stdout)
    command(service, "diagnose", str(folder), "--out", str(folder / "out"))
    return folder, job, json.loads((folder / "out" / "report.json").read_text())


def test_the_service_gives_the_commands_report(done):
    _, job, report = done
    ours = job["result"]["report"]
    assert [e["effect"] for e in ours["effects"]] == ["quadratic_drag"]
    assert ours == report


def test_its_model_is_kept_with_its_arrays_and_judged(service, done):
    _, job, _ = done
    decision = json.loads(
        command(service, "gate", "simulated", job["result"]["artifact"], "--json").stdout
    )
    verdict = decision["document"]["verdicts"][0]
    assert (verdict["rule"], verdict["passed"]) == ("rollout_improves", True)
    assert verdict["value"] < 0.2 * verdict["threshold"]


def test_a_blind_trial_is_committed_before_it_is_diagnosed_and_opened_at_its_end(
    service, done, tmp_path
):
    out, words = tmp_path / "trial", ("--trials", "2")
    with closing(Client(service.url)) as client, ThreadPoolExecutor(1) as beside:
        run = beside.submit(command, service, "blindtrial", "simulated", "--out", str(out), *words)
        committed = until(lambda: commitments_of(client))[0]
        # nothing is answered yet: the first machine takes seconds
        assert client.job(committed["subject"])["result"] is None
        run.result()
    report = json.loads((out / "report.json").read_text())
    entries = json.loads(command(service, "audit", "simulated", "--json").stdout)
    assert [e for e in entries if e["kind"] == "blindtrial:committed"] == [committed]
    opened = next(
        e for e in entries if e["kind"] == "job:finished" and e["subject"] == committed["subject"]
    )
    assert committed["sequence"] < opened["sequence"]
    assert opened["facts"]["result"]["report"] == report
    require_commitments(report, committed["facts"]["commitments"])
    assert (out / "report.html").read_text().startswith("<!doctype html>")
    command(service, "audit", "verify")


def commitments_of(client):
    return [e for e in client.audit("simulated") if e["kind"] == "blindtrial:committed"]
