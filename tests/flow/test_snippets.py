"""Snippets of the reference pages: commands as they stand there against one service, Python against
the same, JSON as what it is for.

The tutorial and the how-tos are run whole elsewhere. A command that runs long, waits for a person
or goes on for ever is held against its parser.
"""

import contextlib
import json
import os
import re
import shlex
import subprocess
import sys
import time
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import yaml
from cloudevents.core.bindings.http import HTTPMessage, from_structured_event
from cloudevents.core.formats.json import JSONFormat

from tests.support import forks, recorded
from tests.support.case import write_recordings
from tests.support.robots import ARM
from tests.support.service import ADMIN, ROOT, Service
from tests.support.storage import embedded
from trueup.chapter.data import PLANT as CHAPTER
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.gate.decision import Gate
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal
from trueup.model.simulator.simulator import load_simulator
from trueup.randomise.randomisation import Randomisation
from trueup.recording.mapping import read_mapping
from trueup_cli.main import app
from trueup_client import Client
from trueup_worker.webhook_requests import signature

EXAMPLE = ROOT / "examples" / "emps"
FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
RUN_WHOLE = (
    "tutorial.md",
    "howto-engineer.md",
    "howto-operator.md",
    "howto-auditor.md",
    "howto-chapter.md",
)
PAGES = [
    ROOT / "README.md",
    *sorted(p for p in (ROOT / "docs").rglob("*.md") if p.name != "commands.md"),
]
# need days of recordings: tests of monitoring have them
WATCHED = {
    "calibrate",
    "monitor",
    "alarms",
}
LONG = {
    "serve",
    "work",
    "look",
    "diagnose",
    "diagnosis",
    "blindtrial",
    "chapter",
    "demo",
    "excite",
    "login",
    "mlflow",
    "oci",
    "init",
    "try",
}
# what is no command of ours, or is tested as what `make` does
OTHERS = {
    "make",
    "export",
    "pip",
    "oras",
    "ros2",
    ".",
}
DIGEST = re.compile(r"\b[0-9a-f]{64}\b")


def snippets(page, *kinds):
    return [text for kind, text in FENCE.findall(page.read_text()) if kind in kinds]


def lines(page):
    """Commands of a page's plain blocks, as words."""
    said = [line for text in snippets(page, "") for line in text.splitlines()]
    return [words for words in (shlex.split(line, comments=True) for line in said) if words]


def of_page(pages):
    return pytest.mark.parametrize("page", pages, ids=lambda page: page.stem)


def test_every_snippet_is_of_a_kind_that_is_tested():
    kinds = {
        (page.name, kind)
        for page in PAGES
        for kind, _ in FENCE.findall(page.read_text())
        if page.name not in RUN_WHOLE
    }
    assert {kind for _, kind in kinds} == {"", "python", "json", "yaml", "math"}
    assert {name for name, kind in kinds if kind == "yaml"} == {"operations.md"}
    assert {name for name, kind in kinds if kind == "json"} == {
        "continual.md",
        "gates.md",
        "randomisation.md",
        "recordings.md",
        "robots.md",
        "simulators.md",
        "webhooks.md",
    }


@of_page([page for page in PAGES if lines(page)])
def test_every_command_line_is_one_that_the_command_takes(page):
    for words in lines(page):
        if words[0] == "trueup":
            app.parse_args(words[1:], print_error=False, exit_on_error=False)
        else:
            assert words[0] in OTHERS or words[:2] == ["python", "tools/verify_archive.py"], words


class World:
    """A folder with the examples, a service, and what words in capitals stand for so far."""

    def __init__(self, folder, service):
        self.folder, self.service = folder, service
        self.words = {"/mnt/backup": str(folder / "backup")}
        self.environment = {
            **{name: x for name, x in os.environ.items() if not name.startswith("TRUEUP_")},
            **service.storage.environment,
            "TRUEUP_URL": service.url,
            "TRUEUP_TOKEN": ADMIN,
            "XDG_STATE_HOME": str(folder / "state"),
        }

    def run(self, words, **environment):
        """A command as it stands, and what it printed."""
        arguments = [self.words.get(word, word) for word in words[1:]]
        done = forks.run("trueup_cli.main", arguments, self.environment | environment, self.folder)
        assert done.returncode == 0, (words, done.stdout, done.stderr)
        for command, capital in (("fit", "CANDIDATE"), ("gate", "DECISION")):
            if words[1] == command:
                (self.words[capital],) = DIGEST.findall(done.stdout)
        if words[1:3] == ["token", "issue"]:
            self.words["0123456789ab"] = done.stdout.split("_")[1]
        return done.stdout


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """What the commands of the page of all tasks leave behind, run in their order."""
    folder = tmp_path_factory.mktemp("snippets")
    for name in ("examples", "tools"):
        (folder / name).symlink_to(ROOT / name)
    healthy_runs(folder / "my-healthy-runs")
    with Service(embedded(folder / "data")).running() as service:
        found = World(folder, service)
        found.printed = {
            " ".join(words): found.run(words)
            for words in lines(ROOT / "docs" / "usage.md")
            if can_run(words)
        }
        yield found


def healthy_runs(folder):
    """A recording of the example once more, as if of healthy operation."""
    folder.mkdir()
    layout = Plant.from_document(json.loads((EXAMPLE / "plant.json").read_text())).layout
    recorded = read_episode((EXAMPLE / "0-adaptation.mcap").read_bytes(), layout)
    write_recordings(folder, [replace(recorded, role=Role.REFERENCE)])


def can_run(words):
    of_a_long_one = words[1:3] == ["convert", "diagnosis"]
    return (
        words[0] == "trueup" and words[1] not in LONG | WATCHED | {"keygen"} and not of_a_long_one
    )


def test_readmes_commands_lead_from_a_log_to_a_corrected_model(world, tmp_path):
    (tmp_path / "my-log").mkdir()
    for seed in range(4):
        recorded.as_csv(recorded.simulated(seed=seed), tmp_path / "my-log" / f"run-{seed}.csv")
    elsewhere = World(tmp_path, world.service)
    said = {
        words[1]: elsewhere.run(words)
        for words in lines(ROOT / "README.md")
        if words[0] == "trueup" and words[1] not in LONG - {"init", "diagnose"} | {"keygen"}
    }
    assert list(said) == ["init", "doctor", "diagnose", "consistency", "convert"]
    assert "Coulomb friction" in said["diagnose"]
    assert "recordings agree on" in said["consistency"] or "do not agree" in said["consistency"]
    assert (tmp_path / "model.onnx").stat().st_size > 0


def test_the_commands_of_all_tasks_do_in_their_order_what_they_say(world):
    said = world.printed
    assert len(said) > 14
    assert "every step is a person's" in said["trueup policy emps"]
    assert "accepted" in said["trueup gate emps CANDIDATE --rules examples/emps/gate.json"]
    assert "rolled_back" in said["trueup rollback emps"]
    assert "holds" in said["trueup audit verify"]
    assert "agrees" in said["trueup replay DECISION"]
    for name in ("model.onnx", "predicted.csv"):
        assert (world.folder / name).exists()


@pytest.mark.parametrize("name", ["access", "audit"])
def test_commands_of_a_page_run_in_their_order(world, name):
    if name == "access":
        world.run(["trueup", "project", "create", "lab"])
    world.words["DIGEST"] = world.words["CANDIDATE"]
    ran = [world.run(words) for words in lines(ROOT / "docs" / f"{name}.md") if can_run(words)]
    assert len(ran) > 2


def test_monitoring_is_tried_with_the_runs_of_a_car(world):
    said = {
        " ".join(words[1:3]): world.run(words)
        for words in lines(ROOT / "docs" / "continual.md")[:9]
    }
    assert "accepted" in said["gate car"]
    assert "one false alarm in 1 h" in said["calibrate car"]
    assert "car: watched" in said["monitor car"]


def test_what_operations_tells_goes_out_and_comes_back(world, tmp_path):
    world.words["KEY"] = world.run(["trueup", "audit", "key"]).strip()
    elsewhere = {name: embedded(tmp_path / name).environment for name in ("restore", "import")}
    ran = set()
    for words in lines(ROOT / "docs" / "operations.md"):
        if words[0] == "python":
            subprocess.run(
                [sys.executable, *(world.words.get(word, word) for word in words[1:])],
                cwd=world.folder,
                check=True,
            )
        elif can_run(words):
            world.run(words, **elsewhere.get(words[1], {}))
            ran.add(words[1])
    assert ran == {"migrate", "backup", "restore", "export", "import", "gc", "fsck"}


def watched_once(client, *arguments, **more):
    return islice(WATCH(client, *arguments, **more), 1)


WATCH = Client.watch


def as_table(run):
    """A run as the columns that a page names."""
    return {"time_s": run.t_s, "pos": run.q, "vel": run.v, "torque": run.u}


@of_page([page for page in PAGES if snippets(page, "python") and page.name not in RUN_WHOLE])
def test_python_of_a_page_runs(world, page, monkeypatch):
    monkeypatch.chdir(world.folder)
    monkeypatch.setattr(Client, "watch", watched_once)  # a robot goes on; a test has seen it once
    monkeypatch.setenv("TRUEUP_TOKEN", ADMIN)
    plant = Plant.from_document(json.loads((EXAMPLE / "plant.json").read_text()))
    t, many = np.arange(200) * plant.timestep_s, np.zeros((3, 200, 1))
    known = {
        "commands": many[0],
        "commands_of_many": many,
        "t_s": t,
        "observed": np.zeros((200, 1)),
        "predictor": Nominal(plant),
    }
    known |= {"u": np.zeros(1), "x": np.zeros(2)}
    known |= {f"run{seed}": as_table(recorded.simulated(600, seed)) for seed in (1, 2, 3)}
    with contextlib.ExitStack() as closing:
        for text in snippets(page, "python"):
            here = text.replace("http://127.0.0.1:8321", world.service.url).replace(
                "trueup_…", ADMIN
            )
            exec(compile(here, str(page), "exec"), known)
            for name, end in (("client", "close"), ("robot", "stop")):
                if name in known:
                    closing.callback(getattr(known.pop(name), end))


def test_the_policy_of_a_page_is_one(world, tmp_path):
    (text,) = snippets(ROOT / "docs" / "continual.md", "json")
    client = Client(world.service.url, token=ADMIN)
    (tmp_path / "policy.json").write_text(
        text.replace("<digest>", client.declare_gate("emps")["digest"])
    )
    client.close()
    assert "promote" in world.run(["trueup", "policy", "emps", str(tmp_path / "policy.json")])


def test_the_gate_of_a_page_is_one():
    (text,) = snippets(ROOT / "docs" / "gates.md", "json")
    assert len(Gate.from_document(json.loads(text)).rules) == 3


def test_the_mapping_of_a_page_is_one():
    (text,) = snippets(ROOT / "docs" / "recordings.md", "json")
    assert [s.signal for s in read_mapping(text).sources] == ["pos [deg]", "vel [deg/s]", "cmd_nm"]


def test_the_family_of_a_page_is_one():
    (text,) = snippets(ROOT / "docs" / "randomisation.md", "json")
    family = Randomisation.of(CHAPTER, json.loads(text))
    assert family.names == ("k", "b", "coulomb_friction.level")


def test_the_robot_of_a_page_is_one(tmp_path):
    (text,) = snippets(ROOT / "docs" / "robots.md", "json")
    (tmp_path / "arm.xml").write_text(ARM)
    plant = Plant.from_document(resolved(json.loads(text), tmp_path))
    assert plant.joints == ("shoulder", "elbow")


def test_the_simulator_of_a_page_is_one(tmp_path):
    load_simulator(ROOT / "examples" / "own-simulator" / "pendulum.py")
    (text,) = snippets(ROOT / "docs" / "simulators.md", "json")
    document = json.loads((EXAMPLE / "plant.json").read_text()) | json.loads(f"{{{text}}}")
    plant = Plant.from_document(resolved(document, tmp_path))
    assert plant.dynamics.parameter_names == ("damping", "inertia", "kt", "mgl")


def test_what_prometheus_scrapes_is_its_own_form():
    (text,) = snippets(ROOT / "docs" / "operations.md", "yaml")
    (job,) = yaml.safe_load(text)["scrape_configs"]
    assert set(job) == {"job_name", "authorization", "static_configs"}


def test_the_event_of_the_page_is_a_cloudevent_that_its_receiver_accepts():
    page = ROOT / "docs" / "webhooks.md"
    (event,), (receiver,) = snippets(page, "json"), snippets(page, "python")
    headers = {"Content-Type": "application/cloudevents+json"}
    read = from_structured_event(HTTPMessage(headers, event.encode()), JSONFormat())
    assert read.get_type() == "trueup.decision.made"
    names: dict = {}
    exec(receiver, names)
    secret, now_s = "whsec_" + "c2VjcmV0" * 4, int(time.time())
    sent = {
        "webhook-id": read.get_id(),
        "webhook-timestamp": str(now_s),
        "webhook-signature": signature(secret, read.get_id(), now_s, event.encode()),
    }
    assert names["verify"](secret, sent, event.encode())
    assert not names["verify"](secret, sent, event.encode() + b" ")
    assert not names["verify"](secret, sent | {"webhook-timestamp": "1"}, event.encode())
