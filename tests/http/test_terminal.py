"""What others wrote never acts on the terminal of whoever runs a command, whatever a server answers
and however files are named."""

import json
import logging
import os
import re
import uuid

import pytest

from tests.http.test_http import accepted, problem, request
from tests.support.forks import run
from tests.support.gates import LENIENT
from tests.support.hostile import CONTROLS, EVIL, hostile
from tests.support.made import plant_document
from tests.support.service import ADMIN, ROOT
from trueup.gate.evidence import SCHEMA
from trueup_cli.error_output import print_traceback
from trueup_client import Client
from trueup_service.logs import JsonLines

# colours, and what moves a progress bar
OURS = re.compile(r"\x1b\[[0-9;]*m|\x1b\[\?25[lh]|\x1b\[[12][AK]|\r")
JSON = {"Content_Type": "application/json"}
COMMANDS = {  # each prints what others wrote, and ends with this code
    "plant list": 0,
    "plant show PLANT": 0,
    "plant show nobody": 1,
    "versions PLANT": 0,
    "decisions PLANT": 0,
    "serving PLANT": 0,
    "serving PLANT --history": 0,
    "evidence PLANT --artifact ARTIFACT": 0,
    "channels PLANT": 1,
    "monitor PLANT": 0,
    "policy PLANT": 1,
    "whoami": 0,
    "token issue somebody auditor": 0,
    "token revoke 000000000000": 1,
    "project create NEW": 0,
    "audit": 0,
    "audit PLANT": 0,
    "fit PLANT": 1,
    "upload PLANT FILE": 1,
    "predict --model FILE --episode FILE --horizon 1 --out OUT": 1,
}
AS_JSON = (
    "plant list",
    "plant show PLANT",
    "versions PLANT",
    "evidence PLANT --artifact ARTIFACT",
    "audit",
    "serving nobody",
)


@pytest.fixture(scope="module")
def filled(service, tmp_path_factory):
    """A hostile service, and names in it."""
    client, plant = Client(service.url, actor="tester"), f"p{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(plant))
    decision = accepted(client, plant, 1.2)
    artifact = client.decision(plant, decision)["candidate"]
    client.add_evidence(plant, evidence(artifact))
    client.declare_channel(plant, "field", [])
    client.close()
    file = tmp_path_factory.mktemp("files") / f"{EVIL.replace('/', '')}.mcap"
    file.write_bytes(b"no recording")
    names = {
        "PLANT": plant,
        "ARTIFACT": artifact,
        "DECISION": decision,
        "FILE": str(file),
        "NEW": plant,
        "OUT": str(file.parent / "out"),
    }
    with hostile(service.port) as url:
        yield url, names


def evidence(artifact, shows="that it moves", cannot_show="anything else"):
    scope = {"shows": shows, "cannot_show": cannot_show}
    return {
        "schema": SCHEMA,
        "artifact": artifact,
        "stage": "SIL",
        "passed": True,
        "figures": {},
        **scope,
    }


def run_on(filled, tmp_path, line, *options, **environment):
    url, names = filled
    here = {
        **os.environ,
        "TRUEUP_URL": url,
        "TRUEUP_TOKEN": ADMIN,
        "XDG_STATE_HOME": str(tmp_path),
        "XDG_CONFIG_HOME": str(tmp_path),
    }
    arguments = [names.get(word, word) for word in line.split()]
    return run("trueup_cli.main", [*arguments, *options], {**here, **environment}, ROOT)


@pytest.mark.parametrize("service", ["embedded"], indirect=True)
@pytest.mark.parametrize("terminal", [False, True], ids=["pipe", "terminal"])
@pytest.mark.parametrize("line", COMMANDS)
def test_nothing_that_a_terminal_obeys_comes_out_of_a_command(filled, tmp_path, line, terminal):
    done = run_on(
        filled,
        tmp_path,
        line,
        **({"FORCE_COLOR": "1", "TERM": "xterm", "COLUMNS": "400"} if terminal else {}),
    )
    output = done.stdout + done.stderr
    output = OURS.sub("", output) if terminal else output
    assert not CONTROLS & set(output)
    assert "\\x1b[2J[red]x" in output, "it is there, seen, and no markup"
    assert done.returncode == COMMANDS[line]


@pytest.mark.parametrize(
    ("words", "seen"),
    [
        (["upload", "p", "--\x1b]0;x\x07"], "--\\x1b]0;x\\x07"),
        (["\u202e"], "\\u202e"),
        (["look", "--data", "\x9b2J"], "\\x9b2J"),
        (["gc", "--older-than-h", "\x1b[2J"], "\\x1b[2J"),
    ],
)
def test_what_is_misused_is_shown_and_not_obeyed(words, seen):
    done = run("trueup_cli.main", words, {**os.environ, "NO_COLOR": "1", "COLUMNS": "200"}, ROOT)
    assert done.returncode == 2
    assert not CONTROLS & set(done.stdout + done.stderr)
    assert seen in done.stderr


@pytest.mark.parametrize("service", ["embedded"], indirect=True)
@pytest.mark.parametrize("line", AS_JSON)
def test_json_is_ascii_and_holds_what_others_wrote(filled, tmp_path, line):
    output = run_on(filled, tmp_path, line, "--json").stdout
    assert output.isascii()
    assert not CONTROLS & set(output)
    assert any(EVIL in text for text in texts(json.loads(output)))


def texts(value):
    """Every text in a JSON value."""
    if isinstance(value, str):
        yield value
    for x in (
        value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    ):
        yield from texts(x)


@pytest.mark.parametrize("character", ["\x1b", "\x9b", "\x7f", "\u202e", "\u2028", "\r"])
def test_evidence_in_words_that_a_terminal_obeys_is_refused(service, filled, character):
    plant, artifact = filled[1]["PLANT"], filled[1]["ARTIFACT"]
    for document in (
        evidence(artifact, shows=f"a{character}b"),
        evidence(artifact, cannot_show=f"a{character}b"),
    ):
        answer = problem(
            service, "POST", f"/v1/plants/{plant}/evidence", json.dumps(document), **JSON
        )
        assert answer[:2] == (422, "bad-evidence")
        assert f"U+{ord(character):04X}" in answer[2]["detail"]
    several = json.dumps(
        evidence(artifact, shows="one line\nand another,\twith a tab: é and \u200d")
    )
    assert request(service, "POST", f"/v1/plants/{plant}/evidence", several, **JSON)[0] in (
        200,
        201,
    )


def test_an_actor_that_a_terminal_obeys_is_refused(service):
    body = json.dumps(plant_document(f"p{uuid.uuid4().hex[:12]}"))
    for actor in ("a\x9b2J", "a\tb", "a\x85b"):
        assert problem(service, "POST", "/v1/plants", body, Trueup_Actor=actor, **JSON)[:2] == (
            400,
            "bad-request",
        )
    for actor in ("a\x1b[2J", "a\x7f"):  # no header may hold these
        assert request(service, "POST", "/v1/plants", body, Trueup_Actor=actor, **JSON)[0] == 400
    assert request(service, "POST", "/v1/plants", body, Trueup_Actor="Zoé", **JSON)[0] == 201


def test_names_of_tokens_and_reasons_are_one_line_of_text(service, client):
    plant = f"p{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(plant))
    first = client.declare_gate(plant, LENIENT)["digest"]
    for name in ("a\x1b[2J", "a\x9b2J", "a\u202eb", "a\nb"):
        body = json.dumps({"name": name, "roles": ["auditor"]})
        assert problem(service, "POST", "/v1/tokens", body, **JSON)[:2] == (422, "invalid-request")
        body = json.dumps({"because": name})
        for path in (f"decisions/{'0' * 64}/approvals", f"alarms/{'0' * 32}/close"):
            answer = problem(service, "POST", f"/v1/plants/p/{path}", body, **JSON)
            assert answer[:2] == (422, "invalid-request")
            assert [f["field"] for f in answer[2]["facts"]["fields"]] == ["body.because"]
    other = {**LENIENT, "scoring": {"horizon_s": 1.0, "windows": "every"}}
    for reason in ("a\x1b[2J", "a\x9b2J", "a\u202eb"):  # which may have several lines
        gate = json.dumps({**other, "follows": first, "because": reason})
        answer = problem(service, "POST", f"/v1/plants/{plant}/gates", gate, **JSON)
        assert answer[:2] == (422, "bad-gate")
        assert "because holds the control character" in answer[2]["detail"]


def test_a_line_of_the_log_is_one_line_of_ascii():
    record = logging.makeLogRecord(
        {"msg": EVIL, "levelname": "INFO", "name": "x", "path": EVIL, "half": "\ud800"}
    )
    line = JsonLines().format(record)
    assert line.isascii()
    assert not CONTROLS & set(line)
    assert "\n" not in line
    assert json.loads(line)["path"] == EVIL


def test_an_error_that_nobody_expected_is_printed_whole_and_quotes_nothing_as_it_is(capsys):
    assert print_traceback(ValueError(EVIL)) == 1
    printed = capsys.readouterr().err
    assert "ValueError: \\x1b[2J[red]x[/]" in printed
    assert not CONTROLS & set(printed)
