"""Every command: its help, its exit codes, JSON, lines in a pipe, and what a shell completes."""

import inspect
import json
import os
import re
import subprocess
import sys
from importlib import import_module

import pytest
from cyclopts import App

from tests.support import forks
from tests.support.completion import completed
from tests.support.service import ROOT
from trueup_cli import exits, main, show
from trueup_cli.error_output import print_error
from trueup_client.problem import DigestMismatch, NotSigned, Problem, Unreachable

# what runs until it is stopped, what is to be watched, what a shell reads
FOR_PEOPLE = {
    "serve",
    "work",
    "demo",
    "try",
    "completion",
}
SHELLS = ("bash", "zsh", "fish", "powershell")


def functions():
    """Every command's name, function and exit codes."""
    for name, (where, _, codes) in main._COMMANDS.items():
        module, attribute = where.split(":")
        command = getattr(import_module(f"trueup_cli.{module}"), attribute)
        if not isinstance(command, App):
            yield name, command, codes
            continue
        for sub in command:
            if not sub.startswith("-"):
                yield f"{name} {sub}", command[sub].default_command, codes
        if command.default_command:
            yield name, command.default_command, codes


ALL = list(functions())


@pytest.mark.parametrize(("name", "function", "codes"), ALL, ids=[name for name, *_ in ALL])
def test_a_command_says_what_it_takes_prints_json_and_names_its_exit_codes(name, function, codes):
    parameters = inspect.signature(function).parameters
    assert ("as_json_" in parameters) == (name not in FOR_PEOPLE)
    assert (exits.UNREACHABLE in codes) == ("url" in parameters)


def test_every_argument_is_explained():
    explained = re.findall(
        r"^\* `(.+?)`:(.*)$", (ROOT / "docs" / "commands.md").read_text(), flags=re.MULTILINE
    )
    assert len(explained) > 100
    assert [
        name for name, text in explained if not re.sub(r"\*+\[.*?\]\*+", "", text).strip()
    ] == []


def run(*arguments, **environment):
    environment = {**os.environ, "TRUEUP_URL": "http://127.0.0.1:9", **environment}
    return forks.run("trueup_cli.main", arguments, environment, ROOT)


@pytest.mark.slow
def test_exit_codes_are_what_they_are_told_to_be(tmp_path):
    assert "Exit codes: 0 done; 1 refused" in run("diagnose", "--help", COLUMNS="200").stdout
    assert run("serving").returncode == exits.MISUSED
    assert run("serving", "emps").returncode == exits.UNREACHABLE
    refused = run(
        "predict", "--model", str(tmp_path), "--episode", "x", "--horizon", "1", "--out", "y"
    )
    assert (refused.returncode, refused.stderr.split()[0]) == (exits.REFUSED, "bad-artifact")
    assert print_error(DigestMismatch("x")) == print_error(NotSigned("x")) == exits.DISAGREES
    assert (
        print_error(Unreachable("x")),
        print_error(Problem(409, {})),
        print_error(ValueError("x")),
    ) == (
        exits.UNREACHABLE,
        exits.REFUSED,
        None,
    )


@pytest.mark.slow
@pytest.mark.parametrize("command", [("completion", "zsh"), ("doctor",)], ids=" ".join)
def test_who_stops_reading_gets_no_traceback(command):
    child = subprocess.Popen(
        [sys.executable, "-m", "trueup_cli.main", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        text=True,
    )
    child.stdout.close()
    with child.stderr:
        assert child.stderr.read() == ""
    assert child.wait() == exits.PIPE_CLOSED


def test_a_table_in_a_pipe_is_a_line_for_each_row(capsys):
    long = "[bold]" + "x" * 300
    show.table("title", ["what", "how many"], [("a\tb", 1.25), (long, None)])
    assert capsys.readouterr().out == f"what\thow many\na b\t1.25\n{long}\t\n"


def test_an_answer_is_printed_with_its_warnings_and_names_as_they_are(capsys):
    gap = {"before": 0.2, "parameters_only": 0.3, "after": 0.1, "floor": 0.01, "closed": None}
    rival = [{"effect": "backlash", "joint": "[bold]"}]
    episodes = [{"sha256": "0" * 64, "role": "adaptation", "period_s": 0.0053}]
    evidence = {"timestep_s": 0.005, "episodes": episodes}
    show.show_diagnosis(
        {
            "verdict": "unknown_effect",
            "gap": gap,
            "indistinguishable": [rival],
            "where": {},
            "evidence": evidence,
        }
    )
    sentence, clock, numbers = capsys.readouterr().out.splitlines()
    assert sentence.endswith("cannot tell this from backlash at [bold].")
    assert "off the declared step" in clock
    assert "held-out predictions worse" in numbers


@pytest.mark.slow
def test_doctor_prints_json():
    parts = json.loads(run("doctor", "--json").stdout)
    assert {"python", "numba", "onnx"} <= {f["part"] for f in parts}


@pytest.mark.slow
def test_shells_complete_commands_and_options(tmp_path):
    for shell in SHELLS:
        assert "diagnose" in run("completion", shell).stdout
    script = run("completion", "bash").stdout
    (tmp_path / "c.sh").write_text(script)
    assert completed("trueup fetch --a", tmp_path / "c.sh") == ["--artifact"]
    assert {"diagnose", "diagnosis"} <= set(completed("trueup diagn", tmp_path / "c.sh"))
    run("completion", "bash", "--install", "--to", str(tmp_path / "there.sh"))
    assert (tmp_path / "there.sh").read_text().strip() == script.strip()
    unknown = run("completion", SHELL="/bin/nothing", PATH="/nowhere")
    assert unknown.returncode in (exits.DONE, exits.REFUSED)
    assert "Traceback" not in unknown.stderr


HELP_LINES, HELP_WIDTH = 24, 80


def helped(*command):
    done = subprocess.run(
        [sys.executable, "-m", "trueup_cli.main", *command, "--help"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "COLUMNS": str(HELP_WIDTH), "TERM": "dumb"},
    )
    return done.stdout


def test_the_list_of_commands_says_what_each_does_in_a_line_and_fits_group_by_group():
    panels = re.split(r"^╭", helped(), flags=re.MULTILINE)[1:]
    lines = [panel.splitlines() for panel in panels]
    assert [title for title in main._GROUPS if not any(title in panel for panel in panels)] == []
    assert max(map(len, lines)) <= HELP_LINES
    rows = [row for panel in lines for row in panel if row.startswith("│")]
    assert all(re.match(r"│ \S+(?: \(-h\))?\s+[A-Z]", row) for row in rows), rows
    assert len(rows) == len(main._COMMANDS) + 2  # help, version


@pytest.mark.parametrize(
    "group", ["plant", "audit", "token", "project", "webhook", "mlflow", "oci"]
)
def test_the_help_of_a_group_says_what_it_is_for_on_one_screen(group):
    text = helped(group)
    assert text.splitlines()[2].endswith(".")
    assert len(text.splitlines()) <= HELP_LINES


def test_the_help_of_a_command_is_all_that_its_docstring_says():
    text = " ".join(helped("init").split())
    assert "holds out the last part of the recordings" in text
