"""`trueup try`: from tables of one's own to a correction that serves, and a walk that ends when the
person says no."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.recorded import as_csv, simulated

TRUEUP = Path(sys.executable).parent / "trueup"
QUESTION = b"[Y/n]"
LONGEST_S = 60.0


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    for seed in range(4):
        as_csv(simulated(seed=seed), folder / f"run-{seed}.csv")
    return folder


def run(*arguments):
    return subprocess.run(
        [TRUEUP, "try", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )


def test_it_leads_from_tables_to_a_correction_that_serves(log, tmp_path):
    done = run(log, "--yes", "--out", tmp_path / "walk")
    assert done.returncode == 0, done.stderr
    for step in ("1  Read", "2  Look", "3  Register", "4  Diagnose", "5  Judge", "6  Promote"):
        assert step in done.stdout
    assert "Coulomb friction" in done.stdout
    assert "promoted" in done.stdout
    page = (tmp_path / "walk" / "report.html").read_text()
    assert "run-0" in page  # recordings have names
    assert "trueup look --data" in done.stdout


def answered(arguments, answers):
    """What a walk prints to a person who gives these answers, one to each question."""
    person, terminal = pty.openpty()
    child = subprocess.Popen(
        [TRUEUP, "try", *map(str, arguments)], stdin=terminal, stdout=terminal, stderr=terminal
    )
    os.close(terminal)
    printed, asked = b"", 0
    while True:
        try:
            part = os.read(person, 4096)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        printed += part
        if printed.count(QUESTION) > asked:
            os.write(person, f"{answers[asked]}\n".encode())
            asked += 1
    os.close(person)
    return child.wait(LONGEST_S), printed.decode()


def test_who_says_no_stops_it_and_is_told_how_to_go_on(log, tmp_path):
    code, printed = answered([log, "--out", tmp_path / "walk"], ["y", "n"])
    assert code == 0
    assert "Is this your machine" in printed
    assert "Diagnose the gap" in printed
    assert "stopped here" in printed
    assert (tmp_path / "walk" / "case" / "plant.json").is_file()
    assert not (tmp_path / "walk" / "registry").exists()


def test_it_asks_nobody_who_is_not_there_and_writes_over_nothing(log, tmp_path):
    refused = run(log, "--out", tmp_path / "walk")
    assert refused.returncode == 1
    assert "--yes" in refused.stderr
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("")
    refused = run(log, "--yes", "--out", tmp_path / "full")
    assert refused.returncode == 1
    assert "not empty" in refused.stderr
