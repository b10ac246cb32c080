"""Every snippet of the tutorial and the how-tos runs and prints what its page says; the site
builds, and loads from nowhere else."""

import json
import os
import re
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.browser import browsing
from tests.support.s3 import until_listening
from tests.support.service import ROOT, free_port
from trueup.model.effect import effects as catalogue
from trueup_client import Client

PAGES = ("tutorial", "howto-engineer", "howto-operator", "howto-auditor", "howto-chapter")
SHARED = "trueup diagnose examples/emps --out diagnosis"  # slow, and on more than one page
FENCE = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def blocks(page):
    return [
        (kind, more.strip(), text)
        for kind, more, text in FENCE.findall((ROOT / "docs" / f"{page}.md").read_text())
    ]


def commands(text):
    """Each command of a block with the lines that it is said to print."""
    found = []
    for line in text.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        else:
            found[-1][1].append(line)
    return found


def plain(text):
    return " ".join(text.split())


def shell_in(folder):
    """Makes a folder like a reader's clone, and returns the environment of a shell there."""
    for name in ("examples", "tools"):
        (folder / name).symlink_to(ROOT / name)
    port = free_port()
    return {
        **{k: v for k, v in os.environ.items() if not k.startswith("TRUEUP_")},
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "TRUEUP_PORT": str(port),
        "TRUEUP_URL": f"http://127.0.0.1:{port}",
        "XDG_STATE_HOME": str(folder / "state"),
        "XDG_CONFIG_HOME": str(folder / "config"),
    }


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """A folder in which the command that pages share has run: its output, and what it wrote."""
    folder = tmp_path_factory.mktemp("shared")
    environment = shell_in(folder)
    with (folder / "printed").open("w") as printed:
        subprocess.run(SHARED.split(), cwd=folder, env=environment, stdout=printed, check=True)
    return folder


@pytest.mark.parametrize("page", PAGES)
def test_every_snippet_of_a_page_runs_and_prints_what_it_says(page, shared, tmp_path):
    environment, folder = shell_in(tmp_path), tmp_path / "said"
    folder.mkdir()
    script, expected, service = ["set -eo pipefail"], [], None
    for kind, more, text in blocks(page):
        if (kind, more) == ("console", "service"):
            ((command, _),) = commands(text)
            service = subprocess.Popen(
                command.split(), cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL
            )
        elif kind == "console":
            for command, lines in commands(text):
                run = command
                if command == SHARED:
                    run = f"cp -r {shared}/diagnosis . && cat {shared}/printed"
                script.append(
                    f"{{ {run}\n}} > said/{len(expected)} || {{ echo {len(expected)} "
                    ">&2; exit 1; }"
                )
                expected.append((command, lines))
        elif kind == "python":
            (folder / f"{len(expected)}.py").write_text(text)
            script.append(f"python -W error said/{len(expected)}.py > said/{len(expected)}")
            expected.append((text, []))
        else:
            pytest.fail(f"a snippet of the kind {kind!r} is not run by anything")
    try:
        if service is not None:
            until_listening(int(environment["TRUEUP_PORT"]), service)
            _until_ready(environment["TRUEUP_URL"])
        done = subprocess.run(
            ["bash"],
            input="\n".join(script),
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
    finally:
        if service is not None:
            service.terminate()
            service.wait(timeout=30)
    assert done.returncode == 0, done.stderr
    assert len(expected) > 3
    for number, (command, lines) in enumerate(expected):
        said, at = plain((folder / str(number)).read_text()), 0
        for line in lines:  # in this order, whatever is between them
            pattern = ".*?".join(re.escape(plain(part)) for part in line.split("…"))
            printed = re.compile(pattern).search(said, at)
            assert printed, f"{command!r} is said to print {line!r} and prints {said[at:]!r}"
            at = printed.end()


def test_the_figures_in_the_prose_of_the_tutorial_are_those_of_its_diagnosis(shared):
    prose = plain((ROOT / "docs" / "tutorial.md").read_text())
    report = json.loads((shared / "diagnosis" / "report.json").read_text())
    level = next(
        e["estimate"]["level"]["value"]
        for e in report["effects"]
        if e["effect"] == "coulomb_friction"
    )
    for words, value in {
        "It is ": report["gap"]["before"],
        "for the declared model and ": report["gap"]["after"],
        "Coulomb friction with a level of about ": level,
        "Refitting them alone brings the error to ": report["gap"]["parameters_only"],
        "on the declared parameters, bring it to ": report["gap"]["effects_only"],
    }.items():
        written = re.search(re.escape(words) + r"([\d.]*\d)", prose).group(1)
        decimals = len(written.partition(".")[2])
        assert written == f"{value:.{decimals}f}", words


def _until_ready(url):
    deadline = time.monotonic() + 60.0
    with closing(Client(url)) as client:
        while not client.is_ready():
            assert time.monotonic() < deadline
            time.sleep(0.1)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built with every link checked."""
    folder = tmp_path_factory.mktemp("built") / "site"
    make = ROOT / "docs" / "site" / "make_site.py"
    made = subprocess.run(
        [sys.executable, make, folder], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return folder


def test_the_site_loads_from_nowhere_else(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 25
    for page in pages:
        loaded = re.findall(
            r'<(?:script|link|img|iframe)[^>]*(?:src|href)="((?:https?:)?//[^"]*)"',
            page.read_text(),
        )
        assert loaded == [], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//", sheet.read_text()), sheet
    effects = (site / "effects.html").read_text()
    assert effects.count("<img") == len(catalogue())
    assert "Predict an episode" in (site / "commands.html").read_text()
    assert "upload_episode" in (site / "python.html").read_text()
    assert not any(":::" in page.read_text() for page in pages)
    method = (site / "diagnosis.html").read_text()
    equations = (ROOT / "docs" / "diagnosis.md").read_text().count("```math")
    assert method.count('display="block"') == equations > 0
    assert "\\sum" not in method


def test_the_site_is_searched_from_a_folder(site):
    asked, faults = [], []
    with browsing() as browser:
        page = browser.new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto((site / "adr" / "0001-folders-say-what-is-deployed.html").as_uri())
        page.get_by_role("button", name="Search").click()
        page.keyboard.type("stribeck")
        page.locator("a", has_text="stribeck_friction").first.click()
        page.wait_for_url("**/effects.html**")
    assert faults == []
    assert all(url.startswith("file:") for url in asked)
