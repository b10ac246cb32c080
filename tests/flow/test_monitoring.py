"""Monitoring from end to end: reference, calibration, telemetry, a drift, its alarm, and the
diagnosis that the alarm opens."""

import time

import numpy as np
import pytest

from tests.support.case import write_recording
from tests.support.made import T0_NS
from tests.support.service import command
from tests.support.simulated import episode_of
from trueup.episode.role import Role
from trueup.model.plant import Plant
from trueup.simulate.excitation import SHAPES, planned
from trueup.simulate.machine import Machine, run
from trueup_client import Client, Problem

STEP_S, SECONDS = 0.02, 16.0
SIGMA = (0.004, 0.006)
DOCUMENT = {
    "name": "watched",
    "nominal": {
        "family": "oscillator",
        "parameters": {"k": 2.0, "c": 0.5, "b": 1.0},
        "timestep_s": STEP_S,
    },
    "commands": [{"name": "u", "unit": "rad/s^2", "limits": [-1.0, 1.0]}],
    "observations": [{"name": "q", "unit": "rad"}, {"name": "v", "unit": "rad/s"}],
    "evaluation": {"horizon_s": 2.0},
}
PLANT = Plant.from_document(DOCUMENT)
HEALTHY, LEAST = 24, 30.0  # episodes of reference; patience [s]


def made(seed, friction=0.0):
    machine = Machine("oscillator", 2.0, 0.5, 1.0, 1.0)
    machine = machine.having("coulomb_friction", {"level": friction}) if friction else machine
    rng = np.random.default_rng(seed)
    series = planned(SHAPES[seed % 4], round(SECONDS / STEP_S) + 1, STEP_S, rng)
    return run(machine, series, STEP_S, 20, SIGMA, rng)


def upload(client, folder, seed, role, friction=0.0, name="watched"):
    episode = episode_of(PLANT, made(seed, friction), Role(role), str(seed))
    path = write_recording(folder / f"{seed}.mcap", episode, T0_NS + seed * 10**11)
    return client.upload_episode(name, path)


def batch(seed, **more):
    found = made(seed)
    return {
        "start_ns": str(T0_NS + seed * 10**11),
        "t_s": found.t_s.tolist(),
        "observations": {"q": found.observed[:, 0].tolist(), "v": found.observed[:, 1].tolist()},
        "commands": {"u": found.issued.tolist()},
        **more,
    }


def until(client, holds):
    end = time.monotonic() + LEAST
    while not holds(state := client.monitor("watched")):
        assert time.monotonic() < end, state
        time.sleep(0.05)
    return state


@pytest.fixture(scope="module")
def watched(service, tmp_path_factory):
    client, folder = Client(service.url, actor="robot"), tmp_path_factory.mktemp("watched")
    client.register_plant(DOCUMENT)
    assert client.monitor("watched")["hint"].startswith("Nobody watches.")
    for seed in range(HEALTHY):
        upload(client, folder, seed, Role.REFERENCE)
    job = client.submit(
        "watched",
        {
            "kind": "calibrate",
            "promise_h": 1.0,
            "detectors": ["likelihood_ratio_cusum", "quantile_run"],
        },
    )
    calibrated = client.wait(job["id"])
    yield client, folder, calibrated
    client.close()


def test_a_drift_is_noticed_and_diagnosed(watched, service):
    client, folder, calibrated = watched
    state = client.monitor("watched")
    assert (state["watches"], state["monitor"], state["alarm"]) == (
        True,
        calibrated["result"]["monitor"],
        None,
    )
    first = client.send_telemetry("watched", batch(100))
    again = client.send_telemetry("watched", batch(100))
    assert (first["role"], first["digest"]) == ("telemetry", again["digest"])
    upload(client, folder, 101, Role.ADAPTATION)
    until(client, lambda s: s["episodes"] == 2)
    assert client.monitor("watched")["alarm"] is None

    for i, role in enumerate([Role.ADAPTATION, Role.ADAPTATION, Role.VALIDATION, Role.ADAPTATION]):
        upload(client, folder, 200 + i, role, friction=0.08)
    state = until(client, lambda s: s["alarm"] is not None and s["alarm"]["job"] is not None)
    alarm = state["alarm"]
    assert "q is predicted" in alarm["document"]["change"]["words"][0]
    assert "likelihood_ratio_cusum" in alarm["document"]["detectors"]
    report = client.wait(alarm["job"])["result"]["report"]
    named = [[e["effect"] for e in report["effects"]], *report["indistinguishable"]]
    assert ["coulomb_friction"] in named  # of which Stribeck's may not be told
    assert len(report["effects"]) == 1
    level = report["effects"][0]["estimate"]["level"]
    assert level["value"] == pytest.approx(0.08, rel=0.15)
    used = {e["sha256"] for e in report["evidence"]["episodes"]}
    assert not used & {e["digest"] for e in client.episodes("watched", "reference")}
    assert client.episode("watched", alarm["episode"])["uses"]["watch"] == 1

    monitor = client.monitor("watched")["monitor"]
    until(client, lambda s: s["episodes"] == 6)
    seen = list(client.watches("watched", monitor))
    assert [w["sequence"] for w in seen] == list(range(1, 7))
    assert seen[-1]["seen"]["channels"]["q"]["rms"] > 2.0 > seen[0]["seen"]["channels"]["q"]["rms"]
    kinds = [e["kind"] for e in client.audit("watched")]
    assert kinds.count("monitor:calibrated") == 1
    assert kinds.count("alarm:raised") == 1

    picture = folder / "monitor.svg"
    said = command(service, "monitor", "watched", "--picture", str(picture)).stdout
    assert "watched: watched, 6 episodes seen" in said
    assert "q is predicted" in command(service, "alarms", "watched").stdout
    assert picture.read_text().startswith("<svg")
    closed = client.close_alarm("watched", alarm["id"], "the brake was dragging; mended")
    assert closed["closed_by"] == "admin for robot"
    with pytest.raises(Problem, match="closed already"):
        client.close_alarm("watched", alarm["id"], "again")
    assert client.monitor("watched")["alarm"] is None
    assert [a["id"] for a in client.alarms("watched")] == [alarm["id"]]


def test_new_episodes_are_looked_at_while_a_diagnosis_runs(watched):
    client, folder, _ = watched
    before = client.monitor("watched")["episodes"]
    job = client.submit("watched", {"kind": "diagnose"})["id"]
    end = time.monotonic() + LEAST
    while client.job(job)["state"] == "queued":
        assert time.monotonic() < end
        time.sleep(0.05)
    upload(client, folder, 300, Role.ADAPTATION)
    until(client, lambda s: s["episodes"] == before + 1)
    assert client.job(job)["state"] == "running"
    client.cancel(job)


@pytest.mark.parametrize(
    ("spoil", "rule"),
    [
        ({"t_s": [0.0]}, "t_s"),
        ({"t_s": [0.0, 0.0]}, "t_s"),
        ({"start_ns": "-1"}, "start_ns"),
        ({"start_ns": 1.5}, "start_ns"),
        ({"observations": {"q": [0.0, 1.0]}}, "observations"),
        ({"commands": {"u": [0.0]}}, "commands"),
        ({"commands": {"u": [0.0, "1"]}}, "commands.u"),
        ({"role": "validation"}, "role"),
        ({"conditions": {"role": "test"}}, "conditions"),
        ({"extra": 1}, "fields"),
    ],
)
def test_a_batch_that_is_no_episode_is_refused_with_the_rule_that_it_breaks(watched, spoil, rule):
    client, _, _ = watched
    sound = {
        "start_ns": "0",
        "t_s": [0.0, 0.1],
        "observations": {"q": [0.0, 0.1], "v": [0.0, 0.1]},
        "commands": {"u": [0.0, 0.0]},
    }
    with pytest.raises(Problem) as refused:
        client.send_telemetry("watched", {**sound, **spoil})
    assert (refused.value.code, refused.value.facts["rule"]) == ("not-an-episode", rule)
    assert refused.value.hint


def test_a_calibration_without_reference_is_refused(watched):
    client, _, _ = watched
    client.register_plant({**DOCUMENT, "name": "unwatched"})
    with pytest.raises(Problem) as refused:
        client.submit("unwatched", {"kind": "calibrate"})
    assert refused.value.code == "not-identifiable"
    assert "role = reference" in refused.value.hint
